"""Object meshes: reading, checking, tetrahedralisation and shapes made by code."""
