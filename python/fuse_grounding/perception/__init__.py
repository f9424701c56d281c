"""What finds the candidates in a picture."""

from fuse_grounding.perception.embedded import EmbeddedSegmenter
from fuse_grounding.perception.protocol import Detection, Segmenter

__all__ = ["Detection", "EmbeddedSegmenter", "Segmenter"]
