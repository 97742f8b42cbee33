"""Drop-in replacements of other libraries' signed distances, beside the originals."""
