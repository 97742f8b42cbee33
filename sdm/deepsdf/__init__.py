"""DeepSDF: signed distance functions of a class of shapes by an auto-decoder, trained on exact samples."""
