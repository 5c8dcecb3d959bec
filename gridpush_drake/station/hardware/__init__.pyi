from .hardware_link import HardwareLink as HardwareLink
from .hardware_station import HardwareStation as HardwareStation
from .hardware_station import MakeHardwareStation as MakeHardwareStation
from .picture_tracker import PictureTracker as PictureTracker
from .twin import MakeTwin as MakeTwin
from .twin import Twin as Twin
from .twin_camera import TwinCamera as TwinCamera
from .twin_link import TwinLink as TwinLink
