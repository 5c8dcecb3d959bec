"""Symmetric matrices as text, exact to the last bit: base64 of little-endian float64."""

import base64
import binascii

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.errors import IdentificationError

Array = NDArray[np.float64]


def pack_symmetric(matrix: Array) -> str:
    """Packs the lower triangle of a symmetric matrix, row by row, in lines of 76 characters.

    Args:
        matrix: of which the symmetric part is taken, where rounding has left another.

    Returns:
        The text.
    """
    triangle = ((matrix + matrix.T) / 2)[np.tril_indices(len(matrix))]
    return base64.encodebytes(triangle.astype("<f8").tobytes()).decode()


def unpack_symmetric(name: str, text: str, size: int) -> Array:
    """Unpacks a symmetric matrix.

    Args:
        name: what it is, at the head of an error's message.
        text: by `pack_symmetric`.
        size: rows, and columns.

    Returns:
        (size, size).

    Raises:
        IdentificationError: the text is not base64 of a triangle of that size, of finite numbers.
    """
    values = _decode(name, text)
    if len(values) != size * (size + 1) // 2:
        raise IdentificationError(
            f"{name}: holds {len(values)} numbers; expected the lower triangle of a {size} x {size} matrix"
        )
    matrix = np.empty((size, size))
    rows, columns = np.tril_indices(size)
    matrix[rows, columns] = matrix[columns, rows] = values
    return matrix


def _decode(name: str, text: str) -> Array:
    try:
        data = base64.b64decode("".join(text.split()), validate=True)
        values = np.frombuffer(data, dtype="<f8").astype(np.float64)
    except (binascii.Error, ValueError) as error:
        raise IdentificationError(f"{name}: expected base64 of little-endian float64 numbers") from error
    if not np.isfinite(values).all():
        raise IdentificationError(f"{name}: holds a number that is not finite")
    return values
