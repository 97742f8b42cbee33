"""The work of `sdm compute`: meshes from files to maps in files, reading and writing beside the device's work."""
