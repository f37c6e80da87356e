"""Double precision vector and matrix types of the kernels."""

import warp as wp

vec2d = wp.vec2d
vec3d = wp.vec3d
mat33d = wp.mat33d
mat43d = wp.types.matrix(shape=(4, 3), dtype=wp.float64)
vec6d = wp.types.vector(length=6, dtype=wp.float64)
