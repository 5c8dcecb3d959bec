from .cell_colors import CellColors as CellColors
from .film import write_film as write_film
from .overlay import Overlay as Overlay
from .server import AimCamera as AimCamera
from .server import StartMeshcatServer as StartMeshcatServer
from .server import write_recording as write_recording
