"""Planar geometry: rigid motions, convex polygons, outlines, and contours of rasters."""
