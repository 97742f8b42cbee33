"""glTF files: what is looked at before they are parsed."""
