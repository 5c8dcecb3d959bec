from .environments import PushEnvironment as PushEnvironment
from .environments import PushVectorEnvironment as PushVectorEnvironment
from .episode import Episode as Episode
from .episode import GameOptions as GameOptions
from .explore import Explore as Explore
from .push_to_goal import PushToGoal as PushToGoal
from .slide_to_edge import SlideToEdge as SlideToEdge
