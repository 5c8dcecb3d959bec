"""Finds an object in a photograph with depth, and follows it.

Here the pictures are painted; yours come from a camera.
"""

import cv2
import numpy as np

from gridpush_drake.geometry import transform
from gridpush_drake.perception import Camera, Frame, PoseTracker, detect_object

# Your camera: width, height, K and distortion as calibrated, and where it stands (`gridpush calibrate`)
X_WC = np.diag([1.0, -1.0, -1.0, 1.0])  # 0.7 m above the table, looking down
X_WC[:3, 3] = [0.0, 0.0, 0.7]
camera = Camera(640, 480, [[600, 0, 319.5], [0, 600, 239.5], [0, 0, 1]], [], X_WC)


def take_picture(pose, seed):
    """A brown plate, 2 cm high, on a gray table, with noise; color, and depth in m."""
    rng = np.random.default_rng(seed)
    color, depth = np.full((480, 640, 3), 165.0), np.full((480, 640), 0.7)
    corners = np.array([[0, 0], [0.14, 0], [0.14, 0.04], [0.05, 0.04], [0.05, 0.12], [0, 0.12]])
    top = np.column_stack([transform(pose, corners), np.full(len(corners), 0.02)])
    shape = np.zeros((480, 640), np.uint8)
    cv2.fillPoly(shape, [np.round(camera.project(top)).astype(np.int32)], 1)
    color[shape > 0], depth[shape > 0] = (150, 120, 80), 0.68
    color += 2.0 * rng.standard_normal(color.shape)
    depth += 0.001 * rng.standard_normal(depth.shape)
    return Frame(np.clip(color, 0, 255).astype(np.uint8), depth.astype(np.float32), float(seed))


first = take_picture((-0.05, -0.04, 0.3), seed=0)
found = detect_object(first.color, first.depth, camera)
plate = found.make_grid_object(name="plate")
print(
    f"Found: {1e4 * found.outline.area:.1f} cm², {1e3 * found.height:.0f} mm high, {plate.n} cells."
)

tracker = PoseTracker(found.outline_B, found.height, camera)
state = tracker.start(first, found.X_WB)
for seed, pose in enumerate([(-0.05, -0.04, 0.3), (-0.03, -0.04, 0.4), (0.0, -0.02, 0.6)]):
    state, tracked = tracker.track(state, take_picture(pose, seed))
    x, y, theta = tracked.pose
    print(f"  at ({1e3 * x:.1f}, {1e3 * y:.1f}) mm, turned by {np.degrees(theta):.1f} degrees")
