"""The boundary's and the caps' shares of winding numbers on a CPU, by eights: eight edges, nodes or voxels at once."""
