from .environments import PushEnvironment as PushEnvironment
from .environments import PushVectorEnvironment as PushVectorEnvironment
from .episode import Episode as Episode
from .episode import GameOptions as GameOptions
from .games import Explore as Explore
from .games import PushToGoal as PushToGoal
from .games import SlideToEdge as SlideToEdge
from .world import EnvironmentWorld as EnvironmentWorld
