"""Lists of bricks of cells of 16^3 voxels, made together: stage 5 where bricks are measured from lists of their own."""
