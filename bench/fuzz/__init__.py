"""Random damage and random nasty meshes: whatever comes out is right, or refused in one sentence."""
