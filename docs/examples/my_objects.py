"""Finds two objects in a photograph with depth, and follows them while one pushes the other.

Here the pictures are painted; yours come from a camera.
"""

import cv2
import numpy as np

from gridpush_drake.geometry import transform
from gridpush_drake.perception import Camera, Frame, KnownObject, SceneTracker, detect_objects

# Your camera: width, height, K and distortion as calibrated, and where it stands (`gridpush calibrate`)
X_WC = np.diag([1.0, -1.0, -1.0, 1.0])  # 0.7 m above the table, looking down
X_WC[:3, 3] = [0.0, 0.0, 0.7]
camera = Camera(640, 480, [[600, 0, 319.5], [0, 600, 239.5], [0, 0, 1]], [], X_WC)

PLATE = np.array([[0, 0], [0.14, 0], [0.14, 0.04], [0.05, 0.04], [0.05, 0.12], [0, 0.12]])
BLOCK = np.array([[0, 0], [0.08, 0], [0.08, 0.05], [0, 0.05]])


def take_picture(left, seed):
    """A brown plate whose left side is at `left`, m, and a blue block, on a gray table, with noise.

    The plate pushes the block from x = 0.02 m on.
    """
    rng = np.random.default_rng(seed)
    color, depth = np.full((480, 640, 3), 165.0), np.full((480, 640), 0.7)
    plate = (PLATE, (left, -0.04, 0.0), (150, 120, 80))
    block = (BLOCK, (max(0.02, left + 0.14), -0.05, 0.0), (60, 80, 150))
    for corners, pose, tint in (plate, block):
        top = np.column_stack([transform(pose, corners), np.full(len(corners), 0.02)])
        shape = np.zeros((480, 640), np.uint8)
        cv2.fillPoly(shape, [np.round(camera.project(top)).astype(np.int32)], 1)
        color[shape > 0], depth[shape > 0] = tint, 0.68
    color += 2.0 * rng.standard_normal(color.shape)
    depth += 0.001 * rng.standard_normal(depth.shape)
    return Frame(np.clip(color, 0, 255).astype(np.uint8), depth.astype(np.float32), float(seed))


first = take_picture(-0.15, seed=0)
found = detect_objects(first.color, first.depth, camera)
for number, each in enumerate(found.objects, start=1):
    print(f"Found {number}: {1e4 * each.outline.area:.1f} cm², {1e3 * each.height:.0f} mm high.")

# From now on the outlines are known: the objects may touch.
known = [KnownObject(each.outline_B, each.height) for each in found.objects]
tracker = SceneTracker(known, camera)
state = tracker.start(first, [each.X_WB for each in found.objects])
for seed, left in enumerate((-0.15, -0.13, -0.12, -0.11, -0.10)):
    state, poses = tracker.track(state, take_picture(left, seed))
    places = ", ".join(f"({1e3 * each.pose[0]:.1f}, {1e3 * each.pose[1]:.1f}) mm" for each in poses)
    print(f"  plate and block at {places}")
