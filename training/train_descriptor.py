#!/usr/bin/env python3
"""Train the learned descriptor and write its encoder as ONNX.

    train_descriptor.py --views ROOMS.npz --held HELD.npz [--contrast W] [-o FILE.onnx]

Each step draws rooms, stretches them, takes two partial views of each, cuts and turns them, and
asks for two things of their codes: that the decoder makes the complete room of either (the
autoencoder), and that the two are nearer to each other than to any other view in the batch
(weight `--contrast`; 0 is the plain autoencoder of the thesis). Some rooms come twice, stretched
differently or mirrored, so that sizes and sides matter. ROOMS.npz comes from make_room_views.py.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import numpy as np
import torch
from descriptor_network import Decoder, Encoder, chamfer, contrast
from numpy.typing import NDArray
from room_views import RoomViews

from topometric_ros.matching.descriptors.learned import centred

POINTS = 320
"""Points of a view that a step looks at; the finished encoder takes any number."""
COMPLETED = 1024
LOGGED = 100
"""Steps between two lines of the log."""
_CHAMFER_POINTS = 320
_AGAIN = 8
"""Rooms of a batch that come twice, stretched and mirrored otherwise."""
_TEMPERATURE = 0.15


def main() -> None:
    """Train, log, export."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--views", type=Path, required=True)
    parser.add_argument("--held", type=Path, required=True, help="rooms to measure on")
    parser.add_argument("--contrast", type=float, default=1.0)
    parser.add_argument("--steps", type=int, default=2300)
    parser.add_argument("--rooms", type=int, default=32, help="rooms in a batch")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", type=Path, default=Path("learned.onnx"))
    parser.add_argument("--log", type=Path, default=Path("descriptor_loss.csv"))
    args = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)
    encoder = _train(args, RoomViews.load(args.views), RoomViews.load(args.held))
    _export(encoder, args.o)


def _train(args: argparse.Namespace, rooms: RoomViews, held: RoomViews) -> Encoder:
    """Take the steps, the learning rate falling to nothing."""
    rng = np.random.default_rng(args.seed)
    encoder, decoder = Encoder(), Decoder(COMPLETED)
    optimizer = torch.optim.AdamW([*encoder.parameters(), *decoder.parameters()], lr=2e-3)
    mean, started = np.zeros(2), time.process_time()
    with args.log.open("w", newline="") as file:
        log = csv.writer(file)
        log.writerow(["step", "cpu_s", "chamfer_m", "contrast", "held_first", "held_chance"])
        for step in range(1, args.steps + 1):
            rate = 2e-3 * min(1.0, step / 50) * np.cos(np.pi / 2 * step / args.steps)
            for group in optimizer.param_groups:
                group["lr"] = rate
            one, two, whole = _batch(rooms, args.rooms, rng)
            codes = encoder(torch.from_numpy(np.concatenate([one, two])))
            some = torch.from_numpy(rng.choice(COMPLETED, _CHAMFER_POINTS, replace=False))
            away = chamfer(decoder(codes)[:, some], torch.from_numpy(np.concatenate([whole] * 2)))
            apart = contrast(codes[: len(one)], codes[len(one) :], _TEMPERATURE)
            optimizer.zero_grad()
            (away + args.contrast * apart).backward()
            optimizer.step()
            mean += (away.item(), apart.item())
            if step % LOGGED == 0:
                right = _found(encoder, held)
                values = (*mean / LOGGED, right, 1 / len(held.views))
                spent = round(time.process_time() - started)
                log.writerow([step, spent, *(f"{value:.3f}" for value in values)])
                file.flush()
                mean[:] = 0.0
    return encoder


def _batch(
    rooms: RoomViews, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return two views (count, POINTS, 3) of rooms and the complete rooms, all stretched alike."""
    chosen = rng.choice(len(rooms.views), count - _AGAIN, replace=False)
    chosen = np.concatenate([chosen, chosen[:_AGAIN]])
    stretch = np.exp(rng.uniform(-0.3, 0.3, (count, 1, 3))) ** np.array([1.0, 1.0, 0.4])
    stretch[:, :, 0] *= rng.choice([-1.0, 1.0], (count, 1))
    views = [
        _worsened(
            rooms.views[chosen, rng.integers(rooms.views.shape[1], size=count)] * stretch, rng
        )
        for _ in range(2)
    ]
    drawn = rng.choice(rooms.complete.shape[1], _CHAMFER_POINTS, replace=False)
    whole = rooms.complete[chosen][:, drawn] * stretch
    return views[0], views[1], whole.astype(np.float32)


def _worsened(views: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float32]:
    """Cut, voxelise and turn views (B, n, 3) at random: (B, POINTS, 3), centred as maps' rooms."""
    count, points, _ = views.shape
    kept = rng.random((count, points))
    # A vertical cut, as where a room is divided otherwise: at most two fifths are lost.
    angle = rng.uniform(0, 2 * np.pi, (count, 1))
    along = views[:, :, 0] * np.cos(angle) + views[:, :, 1] * np.sin(angle)
    share = np.where(rng.random((count, 1)) < 0.4, rng.uniform(0.05, 0.4, (count, 1)), 0.0)
    rank = np.argsort(np.argsort(along, axis=1), axis=1)
    kept += 2.0 * (rank < share * points)
    # Some sensors see no ceiling.
    top = np.quantile(views[:, :, 2], 0.98, axis=1, keepdims=True) - 0.3
    kept += 2.0 * ((views[:, :, 2] > top) & (rng.random((count, 1)) < 0.15))
    rows = np.argpartition(kept, POINTS, axis=1)[:, :POINTS]
    views = np.take_along_axis(views, rows[:, :, None], axis=1)
    views = views + rng.uniform(-0.05, 0.05, views.shape)
    # What does not belong to the room: up to three of a hundred points.
    stray = rng.random(views.shape[:2]) < rng.uniform(0.0, 0.03, (count, 1))
    views[stray] += rng.normal(0.0, 0.7, (int(stray.sum()), 3))
    return np.stack([centred(view) for view in _turned(views, rng)]).astype(np.float32)


def _turned(views: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Turn each view by quarter turns and the error of a main direction, a few by any angle."""
    count = len(views)
    yaw = rng.integers(0, 4, count) * np.pi / 2 + rng.normal(0.0, 0.03, count)
    yaw = np.where(rng.random(count) < 0.05, rng.uniform(0, 2 * np.pi, count), yaw)
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x, y, z = np.moveaxis(views, 2, 0)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=2)


def _found(encoder: Encoder, held: RoomViews) -> float:
    """Return the share of held-out rooms whose second view is nearest to their first one.

    Both are turned by a quarter against each other, and coded in four turns as rooms of maps are.
    """
    encoder.eval()
    codes = []
    for view, turns in ((0, 0), (1, 1)):
        total = 0.0
        for quarter in range(4):
            c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][(quarter + turns) % 4]
            turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
            points = np.stack([centred(p @ turn) for p in held.views[:, view, ::2].astype(float)])
            with torch.no_grad():
                total = total + encoder(torch.from_numpy(points.astype(np.float32)))
        codes.append(total)
    encoder.train()
    both = torch.cat(codes)
    both = (both - both.mean(0)) / both.std(0)
    nearest = torch.cdist(both[: len(held.views)], both[len(held.views) :]).argmin(dim=1)
    return float((nearest == torch.arange(len(nearest))).float().mean())


def _export(encoder: Encoder, path: Path) -> None:
    """Write the encoder as ONNX, for any number of clouds of any size."""
    encoder.eval()
    torch.onnx.export(
        encoder,
        (torch.zeros(2, 64, 3),),
        str(path),
        input_names=["points"],
        output_names=["code"],
        dynamic_axes={"points": {0: "clouds", 1: "points"}, "code": {0: "clouds"}},
        opset_version=17,
        dynamo=False,
    )


if __name__ == "__main__":
    main()
