"""Signs by a flood from outside: regions that a ball reaches, and the way uphill from every other voxel."""
