from .bodies import Scene as Scene
from .bodies import SceneBody as SceneBody
from .motion import SceneJacobian as SceneJacobian
from .motion import SceneMotion as SceneMotion
from .simulation import simulate_scene as simulate_scene
