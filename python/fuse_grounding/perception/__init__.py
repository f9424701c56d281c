"""What finds the candidates in a picture."""

from fuse_grounding.perception.embedded import EmbeddedSegmenter
from fuse_grounding.perception.prompts import check_labels, check_picture
from fuse_grounding.perception.protocol import Detection, Encoder, Segmenter, TextEncoder

__all__ = [
    "Detection",
    "EmbeddedSegmenter",
    "Encoder",
    "Segmenter",
    "TextEncoder",
    "check_labels",
    "check_picture",
]
