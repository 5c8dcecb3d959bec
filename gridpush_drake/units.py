"""Factors between units: multiply by one to convert a value."""

import math

MM_PER_M = 1000.0
"""Millimeters in a meter."""

M_PER_MM = 1e-3
"""Meters in a millimeter."""

M_PER_CM = 0.01
"""Meters in a centimeter."""

M_PER_INCH = 0.0254
"""Meters in an inch."""

CM2_PER_M2 = 1e4
"""Square centimeters in a square meter."""

DEG_PER_RAD = 180.0 / math.pi
"""Degrees in a radian."""

PERCENT_PER_ONE = 100.0
"""Percent in the whole."""

MS_PER_S = 1000.0
"""Milliseconds in a second."""

NS_PER_S = 10**9
"""Nanoseconds in a second."""

S_PER_NS = 1e-9
"""Seconds in a nanosecond."""

GRAMS_PER_KG = 1000.0
"""Grams in a kilogram."""

KG_PER_GRAM = 1e-3
"""Kilograms in a gram."""

BYTES_PER_MEGABYTE = 2**20
"""Bytes in a megabyte."""
