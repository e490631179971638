"""Deep closest point (Wang & Solomon 2019; thesis §4.4.1), small and for level clouds.

Two edge convolutions describe every point by its surroundings, attention lets the two clouds look
at themselves and at each other, and every source point gets a soft counterpart in the target: the
mean of the target's points weighted by the likeness of features. A weight says whether the source
point has a counterpart at all. The transform is not the network's: a weighted SVD that turns about
the vertical only makes it of the counterparts (`fusion/deep_closest_point.py`).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

WIDTH = 64
_HEADS = 4
_NEIGHBOURS = 12
SCALE = 3.0
"""Coordinates are divided by it on the way in, m."""


class EdgeConvolution(nn.Module):
    """The largest response over the nearest neighbours, and the point's own (DGCNN)."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.own, self.near = nn.Linear(inputs, WIDTH), nn.Linear(inputs, WIDTH)

    def forward(self, features: Tensor, neighbours: Tensor) -> Tensor:
        """Return features (B, n, WIDTH); `neighbours` (B, n, k) are rows."""
        count, points, k = neighbours.shape
        rows = neighbours.reshape(count, points * k, 1).expand(-1, -1, WIDTH)
        near = self.near(features)
        around = near.gather(1, rows).reshape(count, points, k, WIDTH).max(dim=2).values
        return torch.relu(self.own(features) + around - near)


class Attention(nn.Module):
    """One cloud looks at another, or at itself, then thinks (a transformer's layer)."""

    def __init__(self) -> None:
        super().__init__()
        self.ask, self.offer = nn.Linear(WIDTH, WIDTH), nn.Linear(WIDTH, 2 * WIDTH)
        self.join = nn.Linear(WIDTH, WIDTH)
        self.think = nn.Sequential(
            nn.Linear(WIDTH, 2 * WIDTH), nn.ReLU(), nn.Linear(2 * WIDTH, WIDTH)
        )
        self.first, self.second = nn.LayerNorm(WIDTH), nn.LayerNorm(WIDTH)

    def forward(self, features: Tensor, others: Tensor) -> Tensor:
        """Return features (B, n, WIDTH) that know of `others` (B, m, WIDTH)."""
        keys, values = self.offer(self.first(others)).chunk(2, dim=2)
        asked, keys, values = (
            x.reshape(x.shape[0], -1, _HEADS, WIDTH // _HEADS).transpose(1, 2)
            for x in (self.ask(self.first(features)), keys, values)
        )
        likeness = torch.softmax(asked @ keys.transpose(2, 3) / (WIDTH // _HEADS) ** 0.5, dim=3)
        heard = (likeness @ values).transpose(1, 2).reshape(features.shape)
        features = features + self.join(heard)
        thought: Tensor = features + self.think(self.second(features))
        return thought


class DeepClosestPoint(nn.Module):
    """Two clouds (B, n, 6) and (B, m, 6) to counterparts (B, n, 3), m, and weights (B, n).

    Six numbers a point: where it is from the middle of the target, m, and its normal, zeros where
    the free side is unknown. The source lies where it is believed to be.
    """

    def __init__(self) -> None:
        super().__init__()
        self.enter = nn.Sequential(nn.Linear(6, WIDTH), nn.ReLU())
        self.edges = nn.ModuleList([EdgeConvolution(WIDTH), EdgeConvolution(WIDTH)])
        self.itself, self.each_other = Attention(), Attention()
        self.matched = nn.Linear(WIDTH, WIDTH)
        self.weight = nn.Linear(WIDTH, 1)

    def forward(self, source: Tensor, target: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return counterparts, weights before the sigmoid and the logits of pairs (B, n, m)."""
        own, other = self._described(source), self._described(target)
        own, other = self.itself(own, own), self.itself(other, other)
        own, other = self.each_other(own, other), self.each_other(other, own)
        logits = self.matched(own) @ self.matched(other).transpose(1, 2) / WIDTH**0.5
        counterparts = torch.softmax(logits, dim=2) @ target[:, :, :3]
        return counterparts, self.weight(own)[:, :, 0], logits

    def _described(self, cloud: Tensor) -> Tensor:
        places = cloud[:, :, :3]
        square = (places**2).sum(2)[:, None] - 2 * places @ places.transpose(1, 2)
        neighbours = square.topk(_NEIGHBOURS, dim=2, largest=False).indices
        features: Tensor = self.enter(torch.cat([places / SCALE, cloud[:, :, 3:]], dim=2))
        for edge in self.edges:
            features = features + edge(features, neighbours)
        return features


def level_fit(source: Tensor, counterparts: Tensor, weights: Tensor) -> Tensor:
    """Return yaw (rad) and translation of least squares: (B, 4), of (B, n, 3) and (B, n).

    In the plane the SVD's rotation has a closed form, which is better to differentiate.
    """
    share = (weights / weights.sum(dim=1, keepdim=True).clamp_min(1e-6))[:, :, None]
    middle, there = (share * source).sum(1), (share * counterparts).sum(1)
    p, q = source - middle[:, None], counterparts - there[:, None]
    cosine = (share[:, :, 0] * (p[:, :, :2] * q[:, :, :2]).sum(2)).sum(1)
    cross = p[:, :, 0] * q[:, :, 1] - p[:, :, 1] * q[:, :, 0]
    yaw = torch.atan2((share[:, :, 0] * cross).sum(1), cosine + 1e-9)
    return torch.cat([yaw[:, None], there - turned(middle[:, None], yaw)[:, 0]], dim=1)


def turned(points: Tensor, yaw: Tensor) -> Tensor:
    """Return points (B, n, 3) turned about z by yaw (B,), rad."""
    c, s = torch.cos(yaw)[:, None], torch.sin(yaw)[:, None]
    x, y, z = points.unbind(dim=2)
    return torch.stack([c * x - s * y, s * x + c * y, z], dim=2)
