"""The object that a learned planner thinks about: the candidate whose text is most like the picture.

(Supplement, "Amortized Planner Architecture".) Ties keep the order of the candidates.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fuse_grounding.perception.protocol import Encoder


def nearest_candidate(encoder: Encoder, image: np.ndarray, labels: Sequence[str]) -> str:
    """The label of `labels` with the highest cosine with `image` (D,); both are of unit length."""
    return labels[int(np.argmax(encoder.text(labels) @ image))]
