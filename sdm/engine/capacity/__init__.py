"""Maps of meshes never seen before, from recordings that have room for meshes of many sizes."""
