#!/usr/bin/env python3
"""Train deep closest point and write its network as ONNX.

    train_registration.py --views ROOMS.npz --held HELD.npz [-o FILE.onnx]

Each step draws rooms, stretches them, takes two partial views of each and moves one by up to 30
degrees and 1.0 m. Asked for are: the right counterpart of every source point that has one (as a
choice among the target's points, and as a place), whether it has one, and the transform that
follows. ROOMS.npz comes from make_room_views.py.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from registration_network import DeepClosestPoint, level_fit, turned
from room_views import RoomViews
from torch import Tensor, nn

POINTS = 128
"""Points of each view in a step; the finished network takes any number from 12 on."""
YAW, SHIFT, LIFT = np.radians(30.0), 1.0, 0.2
"""By how much a view is moved at most: rad, m on the plan, m in height."""
LOGGED = 50
"""Steps between two lines of the log."""
_NEAR = 0.3
"""A source point has a counterpart where the other view has a point so near, m."""
_UNSIDED = 0.15
"""Share of points whose free side is taken away."""

Clouds = tuple[Tensor, Tensor, Tensor, Tensor]


def main() -> None:
    """Train, log, export."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--views", type=Path, required=True)
    parser.add_argument("--held", type=Path, required=True, help="rooms to measure on")
    parser.add_argument("--steps", type=int, default=1650)
    parser.add_argument("--pairs", type=int, default=16, help="pairs of views in a batch")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", type=Path, default=Path("deep_closest_point.onnx"))
    parser.add_argument("--log", type=Path, default=Path("registration_loss.csv"))
    args = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)
    _export(_train(args, RoomViews.load(args.views), RoomViews.load(args.held)), args.o)


def _train(args: argparse.Namespace, rooms: RoomViews, held: RoomViews) -> DeepClosestPoint:
    """Take the steps, the learning rate falling to nothing."""
    rng = np.random.default_rng(args.seed)
    network = DeepClosestPoint()
    optimizer = torch.optim.AdamW(network.parameters(), lr=1e-3)
    mean, started = np.zeros(3), time.process_time()
    with args.log.open("w", newline="") as file:
        log = csv.writer(file)
        log.writerow(["step", "cpu_s", "pairs", "weights", "apart_m", "held_apart_m"])
        for step in range(1, args.steps + 1):
            rate = 1e-3 * min(1.0, step / 100) * np.cos(np.pi / 2 * step / args.steps)
            for group in optimizer.param_groups:
                group["lr"] = rate
            parts = _losses(network, *batch(rooms, args.pairs, rng))
            optimizer.zero_grad()
            sum(parts).backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            mean += [part.item() for part in parts]
            if step % LOGGED == 0:
                with torch.no_grad():
                    last = _losses(network, *batch(held, 32, np.random.default_rng(1)))[2]
                row = [f"{value:.3f}" for value in (*mean / LOGGED, last.item())]
                log.writerow([step, round(time.process_time() - started), *row])
                file.flush()
                mean[:] = 0.0
    return network


def _losses(
    network: DeepClosestPoint, source: Tensor, target: Tensor, truth: Tensor, near: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the losses of the pairs, of the weights, and how far the source ends from the truth.

    `source`, `target` (B, n, 6), `truth` (B, n, 3) where the source's points belong, `near` (B, n)
    whether the other view has a point there.
    """
    counterparts, weights, logits = network(source, target)
    choice = torch.cdist(truth, target[:, :, :3])
    # Any of the target's points around the place will do, the nearest most.
    wanted = torch.softmax(-((choice / 0.3) ** 2), dim=2)
    chosen = -(wanted * torch.log_softmax(logits, dim=2)).sum(2)
    off = (counterparts - truth).norm(dim=2)
    held = near.sum().clamp_min(1.0)
    pairs = (near * (0.3 * chosen + off)).sum() / held
    known = nn.functional.binary_cross_entropy_with_logits(weights, near)
    pose = level_fit(source[:, :, :3], counterparts, torch.sigmoid(weights))
    ended = turned(source[:, :, :3], pose[:, 0]) + pose[:, None, 1:]
    apart = (ended - truth).norm(dim=2).mean()
    return pairs, known, apart


def batch(rooms: RoomViews, count: int, rng: np.random.Generator) -> Clouds:
    """Return source, target, the source's true places and whether the target has them."""
    chosen = rng.choice(len(rooms.views), count, replace=False)
    stretch = np.exp(rng.uniform(-0.3, 0.3, (count, 1, 3))) ** np.array([1.0, 1.0, 0.4])
    stretch[:, :, 0] *= rng.choice([-1.0, 1.0], (count, 1))
    facing = rng.uniform(0, 2 * np.pi, count)
    pair = np.argsort(rng.random((count, rooms.views.shape[1])), axis=1)[:, :2]
    clouds = []
    for k in range(2):
        points = _turned(rooms.views[chosen, pair[:, k]] * stretch, facing)
        normals = rooms.normals[chosen, pair[:, k]] / stretch
        normals = _turned(normals / np.linalg.norm(normals, axis=2, keepdims=True), facing)
        clouds.append((points + rng.uniform(-0.03, 0.03, points.shape), normals))
    (truth, normals), (others, facings) = clouds
    rows = rng.choice(truth.shape[1], POINTS, replace=False)
    truth, normals = truth[:, rows], normals[:, rows]
    near = _held(truth, normals, others, facings)
    rows = rng.choice(others.shape[1], POINTS, replace=False)
    others, facings = others[:, rows], facings[:, rows]
    middle = others.mean(axis=1, keepdims=True)
    truth, others = truth - middle, others - middle
    yaw = rng.uniform(-YAW, YAW, count)
    shift = rng.uniform(-1.0, 1.0, (count, 1, 3)) * (SHIFT, SHIFT, LIFT)
    source = np.concatenate([_turned(truth, yaw) + shift, _sided(_turned(normals, yaw), rng)], 2)
    target = np.concatenate([others, _sided(facings, rng)], 2)
    parts = (torch.from_numpy(x.astype(np.float32)) for x in (source, target, truth, near))
    return tuple(parts)  # type: ignore[return-value]


def _held(
    truth: NDArray[np.float64],
    normals: NDArray[np.float64],
    others: NDArray[np.float64],
    facings: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Return whether the other view has each point, seen from the same side: (B, n)."""
    places = [torch.from_numpy(x.astype(np.float32)) for x in (truth, others)]
    distance, nearest = torch.cdist(*places).min(dim=2)
    sides = np.take_along_axis(facings, nearest.numpy()[:, :, None], axis=1)
    agree: NDArray[np.bool_] = (distance.numpy() < _NEAR) & ((normals * sides).sum(2) > 0.3)
    return agree


def _sided(normals: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Take the normals of some points away, as where the free side is unknown."""
    return normals * (rng.random(normals.shape[:2]) >= _UNSIDED)[:, :, None]


def _turned(points: NDArray[np.float64], yaw: NDArray[np.float64]) -> NDArray[np.float64]:
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x, y, z = np.moveaxis(points, 2, 0)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=2)


class _Shipped(nn.Module):
    """What is exported: without the logits, weights between 0 and 1."""

    def __init__(self, network: DeepClosestPoint) -> None:
        super().__init__()
        self.network = network

    def forward(self, source: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
        counterparts, weights, _ = self.network(source, target)
        return counterparts, torch.sigmoid(weights)


def _export(network: DeepClosestPoint, path: Path) -> None:
    """Write the network as ONNX, for clouds of any size."""
    torch.onnx.export(
        _Shipped(network).eval(),
        (torch.randn(1, 64, 6), torch.randn(1, 80, 6)),
        str(path),
        input_names=["source", "target"],
        output_names=["counterparts", "weights"],
        dynamic_axes={
            "source": {1: "points"},
            "target": {1: "others"},
            "counterparts": {1: "points"},
            "weights": {1: "points"},
        },
        opset_version=17,
        dynamo=False,
    )


if __name__ == "__main__":
    main()
