"""CLIP's text tower (Radford et al., ICML 2021), ViT-B/32's: token ids to unit-length vectors."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F  # noqa: N812 - the name everyone knows
from torch import Tensor, nn

from worker.encoders.lseg.config import Config


def quick_gelu(x: Tensor) -> Tensor:
    """x sigmoid(1.702 x): OpenAI's stand-in for the GELU, which its weights were trained with."""
    return x * torch.sigmoid(1.702 * x)


class Attention(nn.Module):
    """Multi-head causal self-attention, with the parameter names of `torch.nn.MultiheadAttention`."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.in_proj_weight = nn.Parameter(torch.empty(3 * width, width))
        self.in_proj_bias = nn.Parameter(torch.empty(3 * width))
        self.out_proj = nn.Linear(width, width)

    def forward(self, x: Tensor) -> Tensor:
        """(texts, tokens, width) to the same shape; a token sees itself and those before it."""
        n, t, width = x.shape
        qkv = F.linear(x, self.in_proj_weight, self.in_proj_bias).view(n, t, 3, self.heads, width // self.heads)
        q, k, v = qkv.permute(2, 0, 3, 1, 4)
        mixed = F.scaled_dot_product_attention(q, k, v, is_causal=True)
        projected: Tensor = self.out_proj(mixed.transpose(1, 2).reshape(n, t, width))
        return projected


class Block(nn.Module):
    """A pre-norm transformer block."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.ln_1 = nn.LayerNorm(width)
        self.attn = Attention(width, heads)
        self.ln_2 = nn.LayerNorm(width)
        self.mlp = nn.ModuleDict({"c_fc": nn.Linear(width, 4 * width), "c_proj": nn.Linear(4 * width, width)})

    def forward(self, x: Tensor) -> Tensor:
        """(texts, tokens, width) to the same shape."""
        x = x + self.attn(self.ln_1(x))
        inner: Tensor = self.mlp["c_proj"](quick_gelu(self.mlp["c_fc"](self.ln_2(x))))
        return x + inner


class TokenTable(nn.Module):
    """A vector for each token.

    `torch.nn.Embedding` without its random start, which on the device ``meta``, where networks are made before their
    weights are read, imports eight hundred modules of PyTorch's compiler.
    """

    def __init__(self, tokens: int, width: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(tokens, width))

    def forward(self, ids: Tensor) -> Tensor:
        """Ids of any shape to vectors: (..., width)."""
        return F.embedding(ids, self.weight)


class TextTower(nn.Module):
    """Token ids to vectors in the space of the pixels."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        width = config.text_width
        self.token_embedding = TokenTable(config.tokens, width)
        self.positional_embedding = nn.Parameter(torch.empty(config.context, width))
        blocks = nn.ModuleList(Block(width, config.text_heads) for _ in range(config.text_depth))
        self.transformer = nn.ModuleDict({"resblocks": blocks})
        self.ln_final = nn.LayerNorm(width)
        self.text_projection = nn.Parameter(torch.empty(width, config.channels))

    def forward(self, texts: Sequence[Sequence[int]]) -> Tensor:
        """Vectors of texts.

        Parameters
        ----------
        texts : sequence of sequence of int
            Of each text: start token, its own, end token. CLIP pads all of them to its full context; attention is
            causal and only the end token's row is read, so padding cannot be seen, and here goes no further than the
            longest text.

        Returns
        -------
        float32 of shape (texts, channels)
            Unit length.
        """
        length = max(map(len, texts))
        ids = torch.tensor([[*text, *[0] * (length - len(text))] for text in texts])
        x: Tensor = self.token_embedding(ids) + self.positional_embedding[:length]
        for block in self.transformer["resblocks"].children():
            x = block(x)
        ends = torch.tensor([len(text) - 1 for text in texts])
        vectors: Tensor = self.ln_final(x[torch.arange(len(texts)), ends]) @ self.text_projection
        return F.normalize(vectors, dim=-1)
