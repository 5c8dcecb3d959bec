"""What a camera above the table sees: an object, its outline and height, and its pose over time.

Images come in as arrays: color (height, width, 3) uint8 in the order red, green, blue; depth
(height, width) float32, m along the camera's z axis, registered to the color image, 0 or not finite
where it was not measured. The camera frame C is OpenCV's and Drake's: x right, y down in the image,
z forward; the middle of the upper left pixel is (0, 0).

The names below are imported on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
