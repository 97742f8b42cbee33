"""DeepSDF: signed distance functions of a class of shapes by an auto-decoder, trained on exact samples.

J. Park, P. Florence, J. Straub, R. Newcombe, S. Lovegrove, "DeepSDF: Learning continuous signed distance functions
for shape representation", CVPR 2019. Negative inside; lengths inside a model are radii of each shape's unit sphere.
"""

from sdm.deepsdf.infer.code_file import ShapeCode, load_code, save_code
from sdm.deepsdf.infer.encode import encode_meshes, encode_scan
from sdm.deepsdf.infer.estimate_codes import Estimate, estimate_codes
from sdm.deepsdf.infer.isosurface import decode_mesh, decode_near_surface
from sdm.deepsdf.infer.paper_measures import PaperMeasures, earth_movers_distance
from sdm.deepsdf.infer.scan import Scan, half_of
from sdm.deepsdf.infer.scores import ShapeScores, box_diagonal, chamfer_distance, score_shape
from sdm.deepsdf.infer.sphere_trace import interpolation_strip, render, save_picture, sphere_trace
from sdm.deepsdf.networks.decoders import LocalDecoder, PublishedDecoder
from sdm.deepsdf.networks.model import DeepSDF
from sdm.deepsdf.samples.label_surface import label_surface
from sdm.deepsdf.train.settings import Settings, local, published
from sdm.deepsdf.train.training import train

__all__ = [
    "DeepSDF",
    "Estimate",
    "LocalDecoder",
    "PaperMeasures",
    "PublishedDecoder",
    "Scan",
    "Settings",
    "ShapeCode",
    "ShapeScores",
    "box_diagonal",
    "chamfer_distance",
    "decode_mesh",
    "decode_near_surface",
    "earth_movers_distance",
    "encode_meshes",
    "encode_scan",
    "estimate_codes",
    "half_of",
    "interpolation_strip",
    "label_surface",
    "load_code",
    "local",
    "published",
    "render",
    "save_code",
    "save_picture",
    "score_shape",
    "sphere_trace",
    "train",
]
