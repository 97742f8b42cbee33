"""The model of an image: pose, prior, partial volume, appearance, and the backends that give distances."""
