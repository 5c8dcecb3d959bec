"""What a person, or another program, says of where the object is in a photograph.

Where the object cannot be told from the table by its color and height alone (grey metal on a grey
table, a black part in a dark shadow, several objects in view), one of three hints does:

* a *mask*, which another program made (a segmenter), says which pixels show the object. It is taken
  as it is;
* a *box* holds all of the object and nothing else than the object and the table;
* a *click* is a pixel that shows the object.

Within a box, GrabCut (Rother, Kolmogorov and Blake 2004, as OpenCV has it) decides: what lies
outside the box shows what the table looks like, what stands out inside it shows what the object
looks like, and neighboring pixels of like color belong together. A click chooses among the pieces
that stand out from the table. Theory: docs/theory/perception.md, section 2.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gridpush_drake.errors import NoObjectError, PerceptionError
from gridpush_drake.perception.detection.foreground import Foreground, fill_holes, keep_largest
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Color, Mask

CLICK_RADIUS = 5
"""How far from the clicked pixel the object may begin, pixels: nobody clicks better than that."""

GRAB_ROUNDS = 4
"""Rounds of GrabCut; more change hardly a pixel."""

CLOSED_GAPS = (7, 15, 31)
"""In a box, gaps in the object that are narrower than the first of these are closed, pixels: lines
of print, and the dark lines between two materials. Where pieces are left that are too large for
specks, wider gaps are closed: a box holds one object, so its pieces belong together."""

MIN_BOX = 8
"""Smallest side of a box, pixels."""

MIN_MASK = 50
"""Fewest pixels of a mask that can be an object."""

MULTI_PIECE_FRACTION = 0.1
"""A further piece of a mask that has more than this fraction of its pixels makes it a mask of
several objects; smaller ones are specks, and left out."""


@dataclass(frozen=True, eq=False)
class ObjectHint:
    """Where the object is in the photograph as it was taken; at most one of the three is given.

    Attributes:
        mask: (height, width) bool, the pixels that show the object.
        box: left, top, right and bottom of a box that holds the object, pixels; the sides belong to
            the box.
        click: column and row of a pixel that shows the object.

    Raises:
        PerceptionError: several are given, or the box has no area.
    """

    mask: NDArray[np.bool_] | None = None
    box: tuple[float, float, float, float] | None = None
    click: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        given = [one for one in (self.mask, self.box, self.click) if one is not None]
        if len(given) > 1:
            raise PerceptionError("mask, box and click: several are given; expected one of them")
        if self.box is not None:
            left, top, right, bottom = self.box
            if not (right - left >= MIN_BOX and bottom - top >= MIN_BOX):
                raise PerceptionError(
                    f"box is {left:g},{top:g},{right:g},{bottom:g}; expected left,top,right,bottom,"
                    f" pixels, at least {MIN_BOX} apart"
                )

    def place(self, camera: Camera) -> Mask:
        """Draws the hint into the undistorted picture.

        Args:
            camera: camera that took the photograph.

        Returns:
            (height, width) bool: the mask, the box, or a small disc about the click.

        Raises:
            ImageError: the mask has another size than the camera.
            PerceptionError: the hint lies outside the picture.
        """
        drawn = np.zeros((camera.height, camera.width), dtype=bool)
        rows, columns = np.ogrid[: camera.height, : camera.width]
        if self.mask is not None:
            camera.check_size(self.mask, "the mask")
            drawn = np.asarray(self.mask, dtype=bool)
        elif self.box is not None:
            left, top, right, bottom = self.box
            drawn = (columns >= left) & (columns <= right) & (rows >= top) & (rows <= bottom)
        elif self.click is not None:
            x, y = self.click
            if not (-0.5 <= x < camera.width and -0.5 <= y < camera.height):
                raise PerceptionError(
                    f"click is {x:g},{y:g}; expected a pixel of the picture, "
                    f"{camera.width}x{camera.height}"
                )
            drawn = (columns - x) ** 2 + (rows - y) ** 2 <= CLICK_RADIUS**2
        # Masks are not interpolated: a pixel shows the object or does not.
        undistorted = camera.undistort(drawn.astype(np.float32)) > 0
        if not undistorted.any():
            raise PerceptionError("the hint lies outside the picture; expected some of it within")
        return undistorted


def choose_by_mask(drawn: Mask) -> Mask:
    """Takes the object from a mask, without the specks beside it and with small holes as they are.

    Args:
        drawn: (height, width) bool, the mask, undistorted.

    Returns:
        The object's pixels, in one piece.

    Raises:
        PerceptionError: the mask holds hardly any pixel, or several objects.
    """
    chosen = keep_largest(drawn)
    if chosen.sum() < MIN_MASK:
        raise NoObjectError(
            f"the mask has {drawn.sum()} pixels that are not 0; expected those that show the object"
        )
    rest = keep_largest(drawn & ~chosen)
    if rest.sum() > MULTI_PIECE_FRACTION * chosen.sum():
        raise PerceptionError(
            f"the mask has pieces of {chosen.sum()} and {rest.sum()} pixels; expected one object"
        )
    return chosen


def choose_in_box(color: Color, found: Foreground, drawn: Mask) -> Mask:
    """Tells object and table apart within a box.

    Args:
        color: (height, width, 3) uint8, undistorted.
        found: foreground of the picture, which says what probably is object.
        drawn: (height, width) bool, the box, undistorted.

    Returns:
        The object's pixels, in one or several pieces; all False where nothing in the box differs
        from the rest.
    """
    probable = np.where(found.score > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD)
    labels = np.where(drawn, probable, cv2.GC_BGD).astype(np.uint8)
    if not (labels == cv2.GC_PR_FGD).any():
        # Nothing stands out by itself: then the middle of the box is what may be object.
        labels[_shrink(drawn)] = cv2.GC_PR_FGD
    if (labels == cv2.GC_BGD).sum() == 0 or not (labels == cv2.GC_PR_FGD).any():
        return np.zeros_like(drawn)

    # GrabCut clusters colors with OpenCV's generator; seeded, the same picture gives the same mask.
    cv2.setRNGSeed(0)
    bgr = np.ascontiguousarray(color[..., ::-1])
    cv2.grabCut(
        img=bgr,
        mask=labels,
        rect=(0, 0, 0, 0),  # not looked at, as the mask is given
        bgdModel=np.zeros((1, 65)),
        fgdModel=np.zeros((1, 65)),
        iterCount=GRAB_ROUNDS,
        mode=cv2.GC_INIT_WITH_MASK,
    )
    return np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)) & drawn


def join_pieces(pieces: Mask, drawn: Mask, found: Foreground) -> Mask:
    """Joins the pieces in a box, for they are one object's, and leaves specks out.

    Args:
        pieces: (height, width) bool, pixels that show the object.
        drawn: (height, width) bool, the box, undistorted.
        found: foreground of the picture, by which holes are filled.

    Returns:
        The object's pixels, in one piece.
    """
    largest = keep_largest(pieces)
    for width in CLOSED_GAPS:
        brush = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
        closed = cv2.morphologyEx(pieces.astype(np.uint8), cv2.MORPH_CLOSE, brush) > 0
        closed &= drawn
        largest = keep_largest(closed)
        if keep_largest(closed & ~largest).sum() <= MULTI_PIECE_FRACTION * largest.sum():
            break
    return fill_holes(largest, found.score)


def choose_by_click(found: Foreground, drawn: Mask) -> Mask:
    """Takes the piece of the foreground that a click is on, or is next to.

    Args:
        found: foreground of the picture.
        drawn: (height, width) bool, a small disc about the click, undistorted.

    Returns:
        The object's pixels, in one piece; all False where nothing stands out from the table there.
    """
    count, labels = cv2.connectedComponents(found.mask.astype(np.uint8), connectivity=8)
    counts = np.bincount(labels[drawn], minlength=count)
    counts[0] = 0  # the table
    if not counts.any():
        return np.zeros_like(drawn)
    return np.asarray(labels == int(np.argmax(counts)))


def _shrink(box: Mask) -> Mask:
    """The middle of a box: its inner half along each axis."""
    left, top, width, height = cv2.boundingRect(box.astype(np.uint8))
    inner = np.zeros_like(box)
    rows = slice(top + height // 4, top + height - height // 4)
    columns = slice(left + width // 4, left + width - width // 4)
    inner[rows, columns] = True
    return inner & box
