"""The point-completion autoencoder whose code describes a room (after PCN, Yuan et al. 2018).

The encoder is two PointNets, the second of which sees the first one's pooled feature beside every
point; the decoder makes the complete room of the code and is for training only. The last layer of
the encoder standardises the code over the batch, as matching does over the rooms of two maps.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

CODE = 128
SCALE = 3.0
"""Coordinates are divided by it on the way in, m."""


class Encoder(nn.Module):
    """Points (B, n, 3), m, in the frame of `learned.turned_copies`, to codes (B, CODE)."""

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Sequential(nn.Linear(3, 48), nn.ReLU(), nn.Linear(48, 96), nn.ReLU())
        self.local, self.pooled = nn.Linear(96, 96), nn.Linear(96, 96)
        self.second = nn.Linear(96, 256)
        self.head = nn.Sequential(
            nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, CODE), nn.BatchNorm1d(CODE, affine=False)
        )

    def forward(self, points: Tensor) -> Tensor:
        """Return the codes; the order of the points plays no part."""
        own = self.first(points / SCALE)
        seen = own.max(dim=1, keepdim=True).values
        both = torch.relu(self.local(own) + self.pooled(seen))
        code: Tensor = self.head(torch.relu(self.second(both)).max(dim=1).values)
        return code


class Decoder(nn.Module):
    """Codes (B, CODE) to the complete room (B, points, 3), m, in the room's own frame."""

    def __init__(self, points: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(CODE, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(),
            nn.Linear(256, 3 * points),
        )  # fmt: skip

    def forward(self, codes: Tensor) -> Tensor:
        """Return the points of the complete rooms."""
        completed: Tensor = SCALE * self.layers(codes).reshape(len(codes), -1, 3)
        return completed


def chamfer(made: Tensor, true: Tensor) -> Tensor:
    """Return the mean distance to the nearest point, both ways: (B, n, 3) and (B, m, 3) to m."""
    with torch.no_grad():
        square = (true**2).sum(2)[:, None] - 2 * made @ true.transpose(1, 2)
        of_made = square.argmin(dim=2)
        of_true = (square + (made**2).sum(2)[:, :, None]).argmin(dim=1)
    ways = ((made, true, of_made), (true, made, of_true))
    return sum(_apart(points, others, rows) for points, others, rows in ways) / 2


def _apart(points: Tensor, others: Tensor, rows: Tensor) -> Tensor:
    """Return the mean distance of points (B, n, 3) to chosen rows (B, n) of others (B, m, 3)."""
    chosen = others.gather(1, rows[:, :, None].expand(-1, -1, 3))
    return (points - chosen).square().sum(dim=2).add(1e-8).sqrt().mean()


def contrast(codes: Tensor, others: Tensor, temperature: float) -> Tensor:
    """Return how badly two views of a room (B, CODE) each find each other in the batch (InfoNCE).

    By the distance that matching takes: Euclidean, columns standardised, over the root of CODE.
    """
    square = torch.cdist(codes, others) ** 2 / codes.shape[1]
    logits = -square / temperature
    own = torch.arange(len(codes))
    return (
        nn.functional.cross_entropy(logits, own) + nn.functional.cross_entropy(logits.T, own)
    ) / 2
