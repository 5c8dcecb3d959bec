"""Posts fixed on the table, a scenario's `posts`: round obstacles that nothing may touch.

They are bodies of the plant that never move. All tasks plan around them, as around other objects
(`Setting.obstacles`), and the limit monitor tells whether something touched them. The pictures of a
color and depth camera show them; what they hide of the object counts as unseen.
"""

from collections.abc import Sequence

import numpy as np
import shapely
from pydrake.geometry import Cylinder
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.station.schema.scenario import PostConfig

POST_COLOR = (0.35, 0.37, 0.42, 1.0)
"""Color of a post, RGBA."""

POST_FRICTION = 0.5
"""Coefficient of friction of a post, in case that something touches it."""

ARC_SEGMENTS = 8
"""Number of the sides by which a polygon replaces a quarter of a post's outline. The polygon lies
around the circle."""


def AddPosts(plant: MultibodyPlant, posts: Sequence[PostConfig]) -> None:
    """Adds posts, post_0 and so on, to a plant that has a scene graph, before Finalize."""
    friction = CoulombFriction(POST_FRICTION, POST_FRICTION)
    for number, post in enumerate(posts):
        name = f"post_{number}"
        shape = Cylinder(post.radius, post.height)
        # Nothing moves it, so that its mass does not matter.
        inertia = SpatialInertia.SolidCylinderWithMass(1.0, post.radius, post.height, [0, 0, 1])
        body = plant.AddRigidBody(name, plant.AddModelInstance(name), inertia)
        plant.RegisterVisualGeometry(body, RigidTransform(), shape, name, POST_COLOR)
        plant.RegisterCollisionGeometry(body, RigidTransform(), shape, name, friction)
        x, y = post.position
        standing = RigidTransform([x, y, post.height / 2])
        plant.WeldFrames(plant.world_frame(), body.body_frame(), standing)


def place_posts(posts: Sequence[PostConfig]) -> tuple[Polygon, ...]:
    """Returns the outlines of posts in W, m: polygons that lie around the circles."""
    # the sides of a polygon with its corners on a circle lie within it
    widened = 1 / float(np.cos(np.pi / (4 * ARC_SEGMENTS)))
    return tuple(
        shapely.Point(post.position).buffer(widened * post.radius, ARC_SEGMENTS) for post in posts
    )


def leave_out(region: BaseGeometry, obstacles: Sequence[Polygon], distance: float) -> BaseGeometry:
    """Cuts from a region what is nearer than a distance, m, to obstacles."""
    if not obstacles:
        return region
    return region - shapely.union_all(list(obstacles)).buffer(distance)
