"""Where each tensor of transformers' SAM3 model lies in the original checkpoint, `sam3.pt`.

The original keeps the image model under `detector.`, beside a video tracker that is not read. Its modules
are named by their classes' attributes; attention keeps query, key and value in one tensor, position
embeddings have a row for the class token first, and the text projection is stored transposed. The table
below goes from the names that the model wants to the names that the file has, so that what is missing is
known by its name in the file, and what is not wanted is never touched.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

_ROOTS = ("detector.", "sam3_model.", "")
"""Where the image model may lie: as released, in files of its training code, alone."""

_FUSION = (
    ("layer_norm", "norm"),
    ("mlp.fc", "linear"),
    ("o_proj", "out_proj"),
    (".cross_attn.", ".cross_attn_image."),
)
_HEADS = (
    ("box_head", "bbox_embed"),
    ("presence_head", "presence_token_head"),
    ("box_rpb_embed", "boxRPB_embed"),
)

_MODULES: tuple[tuple[str, str, tuple[tuple[str, str], ...]], ...] = (
    (
        "vision_encoder.backbone.",
        "backbone.vision_backbone.trunk.",
        (
            ("embeddings.position_embeddings", "pos_embed"),
            ("embeddings.patch_embeddings.projection", "patch_embed.proj"),
            ("layer_norm1", "norm1"),
            ("layer_norm2", "norm2"),
            ("layer_norm", "ln_pre"),
            ("layers.", "blocks."),
            ("attention.o_proj", "attn.proj"),
            ("attention.", "attn."),
        ),
    ),
    (
        "vision_encoder.neck.fpn_layers.",
        "backbone.vision_backbone.convs.",
        (
            ("scale_layers.0", "dconv_2x2_0"),
            ("scale_layers.2", "dconv_2x2_1"),
            ("proj1", "conv_1x1"),
            ("proj2", "conv_3x3"),
        ),
    ),
    (
        "text_encoder.",
        "backbone.language_backbone.encoder.",
        (
            ("text_model.", ""),
            ("embeddings.token_embedding", "token_embedding"),
            ("embeddings.position_embedding.weight", "positional_embedding"),
            ("text_projection.weight", "text_projection"),
            ("final_layer_norm", "ln_final"),
            ("encoder.layers.", "transformer.resblocks."),
            ("self_attn", "attn"),
            ("layer_norm", "ln_"),
            ("mlp.fc1", "mlp.c_fc"),
            ("mlp.fc2", "mlp.c_proj"),
        ),
    ),
    ("text_projection.", "backbone.language_backbone.resizer.", ()),
    (
        "geometry_encoder.",
        "geometry_encoder.",
        (
            ("vision_layer_norm", "img_pre_norm"),
            ("prompt_layer_norm", "norm"),
            ("output_layer_norm", "encode_norm"),
            ("layers.", "encode."),
            *_FUSION,
        ),
    ),
    ("detr_encoder.", "transformer.encoder.", _FUSION),
    (
        "detr_decoder.",
        "transformer.decoder.",
        (
            ("output_layer_norm", "norm"),
            ("presence_layer_norm", "presence_token_out_norm"),
            ("vision_cross_attn_layer_norm", "norm1"),
            ("text_cross_attn_layer_norm", "catext_norm"),
            ("self_attn_layer_norm", "norm2"),
            ("mlp_layer_norm", "norm3"),
            ("text_cross_attn", "ca_text"),
            ("vision_cross_attn", "cross_attn"),
            ("mlp.fc", "linear"),
            ("o_proj", "out_proj"),
            *_HEADS,
        ),
    ),
    (
        "dot_product_scoring.",
        "dot_prod_scoring.",
        (
            ("text_mlp_out_norm", "prompt_mlp.out_norm"),
            ("text_mlp", "prompt_mlp"),
            ("text_proj", "prompt_proj"),
            ("query_proj", "hs_proj"),
        ),
    ),
    (
        "mask_decoder.",
        "segmentation_head.",
        (
            ("mask_embedder", "mask_predictor.mask_embed"),
            ("instance_projection", "instance_seg_head"),
            ("semantic_projection", "semantic_seg_head"),
            ("prompt_cross_attn_norm", "cross_attn_norm"),
            ("prompt_cross_attn", "cross_attend_prompt"),
            ("o_proj", "out_proj"),
        ),
    ),
)
"""Module of the model, module of the file, and what its parts are called there; the first that fits wins."""

_SPELLINGS = (("dconv_2x2_0", "dconv_2x2"), ("mask_predictor.mask_embed", "mask_embed"))
"""Names with a second spelling: of layers that enlarge once, of heads without a predictor around them."""


@dataclass(frozen=True)
class Source:
    """Names in the file of which one is there, and which third of its rows is meant (None: all)."""

    names: tuple[str, ...]
    third: int | None


def source(name: str) -> Source:
    """Where the model's tensor `name` lies in the original. Raises KeyError for a name of another model."""
    fitting = [entry for entry in _MODULES if name.startswith(entry[0])]
    if not fitting:
        raise KeyError(name)
    module, original, parts = fitting[0]
    rest = name.removeprefix(module)
    third = None
    if found := re.search(r"\b([qkv])_proj\.(weight|bias)$", rest):
        third = "qkv".index(found[1])
        joint = f"qkv.{found[2]}" if module == "vision_encoder.backbone." else f"in_proj_{found[2]}"
        rest = rest[: found.start()] + joint
    for theirs, ours in parts:
        rest = rest.replace(theirs, ours)
    # Heads of several layers count from 0 there.
    rest = re.sub(r"\blayer(\d)\.", lambda n: f"layers.{int(n[1]) - 1}.", rest)
    spelt = [rest, *(rest.replace(one, other) for one, other in _SPELLINGS if one in rest)]
    return Source(tuple(original + s for s in spelt), third)


def translate(
    original: Mapping[str, Any], wanted: Mapping[str, Any]
) -> tuple[dict[str, Any], list[str], list[str]]:
    """Tensors of the original checkpoint under the names of the model.

    `wanted`: the model's tensors by name, for their shapes. Returns the tensors, the names (in the file)
    of those that are missing, and of those whose shape does not fit.
    """
    root = next((r for r in _ROOTS if any(k.startswith(f"{r}backbone.") for k in original)), _ROOTS[0])
    tensors, missing, foreign = {}, [], []
    for name, target in wanted.items():
        place = source(name)
        key = next((root + n for n in place.names if root + n in original), None)
        if key is None:
            missing.append(root + place.names[0])
            continue
        tensor = original[key]
        if place.third is not None and len(tensor) % 3 == 0:
            rows = len(tensor) // 3
            tensor = tensor[place.third * rows : (place.third + 1) * rows]
        elif key.endswith("trunk.pos_embed"):
            tensor = tensor[:, 1:]
        elif key.endswith("encoder.text_projection"):
            tensor = tensor.T
        if tuple(tensor.shape) != tuple(target.shape):
            foreign.append(f"{key} {tuple(tensor.shape)} for {tuple(target.shape)}")
            continue
        tensors[name] = tensor.contiguous()
    return tensors, missing, foreign
