"""Checkpoints of SAM3 and CLIP, tiny and randomly initialised, in every layout that FUSE reads."""

from __future__ import annotations

import json
import os
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

START, END = "<|startoftext|>", "<|endoftext|>"
MERGES = [("m", "u"), ("mu", "g</w>"), ("k", "n")]
SIDE, PATCH, WIDTH, LONGEST = 64, 16, 16, 24

REQUIRED = "FUSE_REQUIRE_DOORS"


def needs(*packages: str) -> None:
    """Skips where a package is not installed, and fails instead where `make test-doors` promised it."""
    for package in packages:
        if os.environ.get(REQUIRED):
            import_module(package)
        pytest.importorskip(package, reason=f"{package} is not installed: make test-doors installs it")


def write_tokenizer(root: Path, files: str = "tokenizer.json") -> int:
    """A byte-level BPE like CLIP's with three merges; the number of its tokens."""
    needs("tokenizers")
    from tokenizers import Regex, Tokenizer, models, normalizers, pre_tokenizers, processors

    alphabet = sorted(pre_tokenizers.ByteLevel.alphabet())
    tokens = [*alphabet, *(c + "</w>" for c in alphabet), *(a + b for a, b in MERGES), START, END]
    vocab = {token: i for i, token in enumerate(tokens)}
    root.mkdir(parents=True, exist_ok=True)
    if files == "vocab.json":
        (root / "vocab.json").write_text(json.dumps(vocab))
        (root / "merges.txt").write_text("\n".join(["#version: 0.2", *(" ".join(m) for m in MERGES)]) + "\n")
        return len(vocab)
    made = Tokenizer(
        models.BPE(vocab=vocab, merges=MERGES, end_of_word_suffix="</w>", unk_token=END, fuse_unk=False)
    )
    made.normalizer = normalizers.Sequence(
        [normalizers.NFC(), normalizers.Replace(Regex(r"\s+"), " "), normalizers.Lowercase()]
    )
    words = Regex(r"'s|'t|'re|'ve|'m|'ll|'d|[\p{L}]+|[\p{N}]|[^\s\p{L}\p{N}]+")
    made.pre_tokenizer = pre_tokenizers.Sequence(
        [
            pre_tokenizers.Split(words, behavior="removed", invert=True),
            pre_tokenizers.ByteLevel(add_prefix_space=False),
        ]
    )
    made.post_processor = processors.RobertaProcessing((END, vocab[END]), (START, vocab[START]))
    made.add_special_tokens([START, END])
    made.save(str(root / "tokenizer.json"))
    return len(vocab)


# -- CLIP ----------------------------------------------------------------------------------------


def clip_model(tokens: int, seed: int = 0) -> Any:
    """A `CLIPModel` of one layer each: pictures of 64 x 64, sixteen patches, 16 dimensions."""
    needs("torch", "transformers")
    import torch
    from transformers import CLIPConfig, CLIPModel

    torch.manual_seed(seed)
    layer = {"hidden_size": 32, "intermediate_size": 48, "num_hidden_layers": 1, "num_attention_heads": 2}
    text = {
        "vocab_size": tokens,
        "bos_token_id": tokens - 2,
        "eos_token_id": tokens - 1,
        "pad_token_id": tokens - 1,
    }
    config = CLIPConfig(
        text_config={**layer, **text, "max_position_embeddings": LONGEST},
        vision_config={**layer, "image_size": SIDE, "patch_size": PATCH},
        projection_dim=WIDTH,
    )
    return CLIPModel(config).eval()


def write_clip(root: Path, seed: int = 0) -> Any:
    """A folder as transformers writes it; the model."""
    model = clip_model(write_tokenizer(root), seed)
    model.save_pretrained(root)
    return model


def write_onnx_clip(root: Path, seed: int = 0) -> None:
    """A folder of ONNX files without any torch: one layer of random numbers each, of the right shapes."""
    needs("onnx", "tokenizers")
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    rng = np.random.default_rng(seed)
    tokens, count = write_tokenizer(root), (SIDE // PATCH) ** 2

    def save(name: str, nodes: list[Any], inputs: Any, outputs: list[Any], numbers: dict[str, Any]) -> None:
        constants = [numpy_helper.from_array(np.asarray(v), k) for k, v in numbers.items()]
        graph = helper.make_graph(nodes, "clip", [inputs], outputs, constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        onnx.save(model, str(root / name))

    def tensor(name: str, kind: Any, shape: list[int]) -> Any:
        return helper.make_tensor_value_info(name, kind, shape)

    save(
        "image.onnx",
        [
            helper.make_node("Conv", ["pixel_values", "w"], ["grid"], strides=[PATCH, PATCH]),
            helper.make_node("Reshape", ["grid", "flat"], ["channels"]),
            helper.make_node("Transpose", ["channels"], ["patch_embeds"], perm=[0, 2, 1]),
            helper.make_node("ReduceMean", ["patch_embeds"], ["image_embeds"], axes=[1], keepdims=0),
        ],
        tensor("pixel_values", TensorProto.FLOAT, [1, 3, SIDE, SIDE]),
        [
            tensor("image_embeds", TensorProto.FLOAT, [1, WIDTH]),
            tensor("patch_embeds", TensorProto.FLOAT, [1, count, WIDTH]),
        ],
        {
            "w": rng.normal(size=(WIDTH, 3, PATCH, PATCH)).astype(np.float32),
            "flat": np.array([1, WIDTH, count], np.int64),
        },
    )
    save(
        "text.onnx",
        [
            helper.make_node("Gather", ["words", "input_ids"], ["found"]),
            helper.make_node("ReduceMean", ["found"], ["text_embeds"], axes=[1], keepdims=0),
        ],
        tensor("input_ids", TensorProto.INT64, [1, LONGEST]),
        [tensor("text_embeds", TensorProto.FLOAT, [1, WIDTH])],
        {"words": rng.normal(size=(tokens, WIDTH)).astype(np.float32)},
    )


# -- SAM3 ----------------------------------------------------------------------------------------


def sam3_model(tokens: int, seed: int = 0) -> Any:
    """A `Sam3Model` of one or two layers a part: pictures of 112 x 112, ten queries."""
    needs("torch", "torchvision", "transformers")
    import torch
    from transformers import Sam3Config, Sam3Model

    torch.manual_seed(seed)
    part = {"hidden_size": 32, "num_layers": 2, "num_attention_heads": 2, "intermediate_size": 48}
    config = Sam3Config(
        vision_config={
            "backbone_config": {
                "model_type": "sam3_vit_model",
                "hidden_size": 32,
                "intermediate_size": 48,
                "num_hidden_layers": 2,
                "num_attention_heads": 2,
                "image_size": 112,
                "patch_size": 14,
                "window_size": 4,
                "global_attn_indexes": [1],
                "pretrain_image_size": 56,
            },
            "fpn_hidden_size": 32,
            "backbone_feature_sizes": [[32, 32], [16, 16], [8, 8]],
        },
        text_config={
            "model_type": "clip_text_model",
            "vocab_size": tokens,
            "bos_token_id": tokens - 2,
            "eos_token_id": tokens - 1,
            "pad_token_id": tokens - 1,
            "hidden_size": 32,
            "intermediate_size": 48,
            "projection_dim": 16,
            "num_hidden_layers": 2,
            "num_attention_heads": 2,
            "max_position_embeddings": LONGEST,
            "hidden_act": "gelu",
        },
        geometry_encoder_config=part,
        detr_encoder_config=part,
        detr_decoder_config={**part, "num_queries": 10},
        mask_decoder_config={"hidden_size": 32, "num_attention_heads": 2},
    )
    model = Sam3Model(config).eval()
    with torch.no_grad():  # random weights say next to nothing: make them differ from query to query
        for parameter in model.parameters():
            parameter.mul_(3.0)
            parameter.add_(0.1 * torch.randn_like(parameter))
    return model


def write_sam3(root: Path, seed: int = 0) -> Any:
    """A folder as transformers writes it; the model."""
    model = sam3_model(write_tokenizer(root), seed)
    model.save_pretrained(root)
    return model


def original_sam3(model: Any) -> dict[str, Any]:
    """The tensors of a model under the names, and in the shapes, of the original's modules.

    Written from the original's module tree, with what else its checkpoint holds: the tracker, a second
    neck, points and the class token.
    """
    import torch

    kept: dict[str, Any] = {}

    def put(name: str, module: Any) -> None:
        for kind, tensor in module.named_parameters(recurse=False):
            kept[f"{name}.{kind}"] = tensor

    def attention(name: str, module: Any, joint: str = "in_proj_", out: str = "out_proj") -> None:
        three = [module.q_proj, module.k_proj, module.v_proj]
        kept[f"{name}.{joint}weight"] = torch.cat([p.weight for p in three])
        kept[f"{name}.{joint}bias"] = torch.cat([p.bias for p in three])
        put(f"{name}.{out}", module.out_proj if hasattr(module, "out_proj") else module.o_proj)

    def head(name: str, module: Any, layers: int) -> None:
        for i in range(layers):
            put(f"{name}.layers.{i}", getattr(module, f"layer{i + 1}"))

    seen, vit = "backbone.vision_backbone", model.vision_encoder.backbone
    places = vit.embeddings.position_embeddings
    kept[f"{seen}.trunk.pos_embed"] = torch.cat([torch.ones_like(places[:, :1]), places], 1)
    put(f"{seen}.trunk.patch_embed.proj", vit.embeddings.patch_embeddings.projection)
    put(f"{seen}.trunk.ln_pre", vit.layer_norm)
    for i, layer in enumerate(vit.layers):
        block = f"{seen}.trunk.blocks.{i}"
        kept[f"{block}.attn.freqs_cis"] = torch.ones(4)
        attention(f"{block}.attn", layer.attention, "qkv.", "proj")
        for ours, theirs in (("layer_norm1", "norm1"), ("layer_norm2", "norm2")):
            put(f"{block}.{theirs}", getattr(layer, ours))
        put(f"{block}.mlp.fc1", layer.mlp.fc1)
        put(f"{block}.mlp.fc2", layer.mlp.fc2)
    for i, layer in enumerate(model.vision_encoder.neck.fpn_layers):
        conv = f"{seen}.convs.{i}"
        if i == 0:
            put(f"{conv}.dconv_2x2_0", layer.scale_layers[0])
            put(f"{conv}.dconv_2x2_1", layer.scale_layers[2])
        elif i == 1:
            put(f"{conv}.dconv_2x2", layer.scale_layers[0])
        put(f"{conv}.conv_1x1", layer.proj1)
        put(f"{conv}.conv_3x3", layer.proj2)
    kept[f"{seen}.sam2_convs.0.conv_1x1.weight"] = torch.ones(2, 2)

    said, text = "backbone.language_backbone", model.text_encoder.text_model
    put(f"{said}.encoder.token_embedding", text.embeddings.token_embedding)
    kept[f"{said}.encoder.positional_embedding"] = text.embeddings.position_embedding.weight
    put(f"{said}.encoder.ln_final", text.final_layer_norm)
    kept[f"{said}.encoder.text_projection"] = model.text_encoder.text_projection.weight.T
    for i, layer in enumerate(text.encoder.layers):
        block = f"{said}.encoder.transformer.resblocks.{i}"
        attention(f"{block}.attn", layer.self_attn)
        put(f"{block}.ln_1", layer.layer_norm1)
        put(f"{block}.ln_2", layer.layer_norm2)
        put(f"{block}.mlp.c_fc", layer.mlp.fc1)
        put(f"{block}.mlp.c_proj", layer.mlp.fc2)
    put(f"{said}.resizer", model.text_projection)

    geometry = model.geometry_encoder
    for same in ("label_embed", "cls_embed", "final_proj"):
        put(f"geometry_encoder.{same}", getattr(geometry, same))
    for same in ("boxes_direct_project", "boxes_pool_project", "boxes_pos_enc_project"):
        put(f"geometry_encoder.{same}", getattr(geometry, same))
    put("geometry_encoder.img_pre_norm", geometry.vision_layer_norm)
    put("geometry_encoder.norm", geometry.prompt_layer_norm)
    put("geometry_encoder.encode_norm", geometry.output_layer_norm)
    kept["geometry_encoder.points_direct_project.weight"] = torch.ones(2, 2)
    for name, layers in (
        ("geometry_encoder.encode", geometry.layers),
        ("transformer.encoder.layers", model.detr_encoder.layers),
    ):
        for i, layer in enumerate(layers):
            attention(f"{name}.{i}.self_attn", layer.self_attn)
            attention(f"{name}.{i}.cross_attn_image", layer.cross_attn)
            put(f"{name}.{i}.linear1", layer.mlp.fc1)
            put(f"{name}.{i}.linear2", layer.mlp.fc2)
            for n in (1, 2, 3):
                put(f"{name}.{i}.norm{n}", getattr(layer, f"layer_norm{n}"))

    decoder, name = model.detr_decoder, "transformer.decoder"
    for i, layer in enumerate(decoder.layers):
        attention(f"{name}.layers.{i}.self_attn", layer.self_attn)
        attention(f"{name}.layers.{i}.ca_text", layer.text_cross_attn)
        attention(f"{name}.layers.{i}.cross_attn", layer.vision_cross_attn)
        put(f"{name}.layers.{i}.linear1", layer.mlp.fc1)
        put(f"{name}.layers.{i}.linear2", layer.mlp.fc2)
        put(f"{name}.layers.{i}.norm1", layer.vision_cross_attn_layer_norm)
        put(f"{name}.layers.{i}.catext_norm", layer.text_cross_attn_layer_norm)
        put(f"{name}.layers.{i}.norm2", layer.self_attn_layer_norm)
        put(f"{name}.layers.{i}.norm3", layer.mlp_layer_norm)
    for same in ("query_embed", "reference_points", "presence_token"):
        put(f"{name}.{same}", getattr(decoder, same))
    put(f"{name}.norm", decoder.output_layer_norm)
    put(f"{name}.presence_token_out_norm", decoder.presence_layer_norm)
    head(f"{name}.bbox_embed", decoder.box_head, 3)
    head(f"{name}.presence_token_head", decoder.presence_head, 3)
    head(f"{name}.ref_point_head", decoder.ref_point_head, 2)
    head(f"{name}.boxRPB_embed_x", decoder.box_rpb_embed_x, 2)
    head(f"{name}.boxRPB_embed_y", decoder.box_rpb_embed_y, 2)

    scoring = model.dot_product_scoring
    head("dot_prod_scoring.prompt_mlp", scoring.text_mlp, 2)
    put("dot_prod_scoring.prompt_mlp.out_norm", scoring.text_mlp_out_norm)
    put("dot_prod_scoring.prompt_proj", scoring.text_proj)
    put("dot_prod_scoring.hs_proj", scoring.query_proj)

    masks, name = model.mask_decoder, "segmentation_head"
    for i in range(3):
        put(f"{name}.pixel_decoder.conv_layers.{i}", masks.pixel_decoder.conv_layers[i])
        put(f"{name}.pixel_decoder.norms.{i}", masks.pixel_decoder.norms[i])
        put(f"{name}.mask_predictor.mask_embed.layers.{i}", masks.mask_embedder.layers[i])
    put(f"{name}.instance_seg_head", masks.instance_projection)
    put(f"{name}.semantic_seg_head", masks.semantic_projection)
    attention(f"{name}.cross_attend_prompt", masks.prompt_cross_attn)
    put(f"{name}.cross_attn_norm", masks.prompt_cross_attn_norm)

    tensors = {f"detector.{key}": tensor.detach().clone() for key, tensor in kept.items()}
    return {**tensors, "tracker.maskmem_tpos_enc": torch.ones(7, 1, 1, 4)}


def write_original_sam3(root: Path, model: Any, **wrapped: Any) -> None:
    """`sam3.pt` with a config.json of its size, and the tokenizer; `wrapped` may replace its tensors."""
    import torch

    write_tokenizer(root, "vocab.json")
    model.config.save_pretrained(root)
    torch.save(wrapped or {"model": original_sam3(model)}, root / "sam3.pt")
