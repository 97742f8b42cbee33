"""Drop-in replacements: functions of other libraries, with their names, signs and types, by exact distances.

    from sdm.compat import trimesh, open3d, igl, mesh_to_sdf

None of these libraries is imported. Signs are those of the library that a function is named after; inside is where the
generalised winding number is above 0.5, whatever method that library has.
"""
