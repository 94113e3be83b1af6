"""Train the network that takes parts apart, on rendered scenes alone; writes its ONNX file.

An environment of its own: pip install -r requirements-train.txt. Then, in bench:

    python -m segmenter.train --steps 20000 --seed 1 --out segmenter.onnx

The same seed and steps give the same scenes in the same order. It goes on where it was ended.
"""

from __future__ import annotations

import argparse
import multiprocessing as mp
import time
from collections import deque
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from segmenter.scenes import draw_scene
from segmenter.targets import STEP, make_targets

WIDTHS = (16, 24, 32, 48, 64, 64)
"""Channels at 1/2, 1/4 ... of the image's resolution."""

BATCH, FRESH = 8, 1
"""Scenes in a step, and how many of them are new."""

KEPT = 4000
"""Scenes that are shown again, the newest ones."""

RATE = 2.5e-3

SAVED_S = 120.0

Example = tuple[np.ndarray, np.ndarray]
"""Image (S, S, 3) uint8 and its maps (4, S / 2, S / 2) float16."""


def block(inward: int, outward: int, stride: int = 1) -> nn.Sequential:
    """Return a convolution of 3 x 3, its normalisation and ReLU."""
    convolution = nn.Conv2d(inward, outward, 3, stride, 1, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outward), nn.ReLU(True))


class Network(nn.Module):
    """A U-net at half of the image's resolution (Ronneberger et al. 2015): from (n, 3, H, W) to
    (n, 4, H / 2, W / 2), as `make_targets` says; the first two are logits. H and W are multiples
    of 64."""

    def __init__(self) -> None:
        super().__init__()
        pairs = list(pairwise(WIDTHS))
        self.stem = block(3, WIDTHS[0], STEP)
        self.down = nn.ModuleList([nn.Sequential(block(a, b, 2), block(b, b)) for a, b in pairs])
        self.across = nn.ModuleList([nn.Conv2d(a, a, 1) for a, _ in pairs])
        self.narrow = nn.ModuleList([nn.Conv2d(b, a, 1) for a, b in pairs])
        self.up = nn.ModuleList([block(a, a) for a, _ in pairs])
        self.out = nn.Conv2d(WIDTHS[0], 4, 1)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """Return the maps."""
        levels = [self.stem(image)]
        for down in self.down:
            levels.append(down(levels[-1]))
        deep = levels[-1]
        for k in reversed(range(len(self.up))):
            wide = F.interpolate(self.narrow[k](deep), scale_factor=2.0, mode="nearest")
            deep = self.up[k](self.across[k](levels[k]) + wide)
        return self.out(deep)


def example(key: tuple[int, int]) -> Example:
    """Draw the scene of a seed and a number; one that cannot be drawn is replaced."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng(key)
    image, instances = draw_scene(rng)
    return image, make_targets(instances).astype(np.float16)


def batches(seed: int, first: int, workers: int) -> Iterator[list[Example]]:
    """Yield the examples of each step from `first` on: some new ones, others shown again."""
    pool: deque[Example] = deque(maxlen=KEPT)
    begin = max(0, first * FRESH - KEPT)
    keys = ((seed, k) for k in range(begin, 2**31))
    with mp.get_context("fork").Pool(workers) as makers:
        drawn = makers.imap(example, keys, chunksize=4)
        while len(pool) < max(BATCH, min(first * FRESH, KEPT)):
            pool.append(next(drawn))
        step = first
        while True:
            for _ in range(FRESH):
                pool.append(next(drawn))
            rng = np.random.default_rng((seed, step, 1))
            again = rng.integers(0, len(pool), BATCH - FRESH)
            yield [pool[k] for k in (*again, *range(len(pool) - FRESH, len(pool)))]
            step += 1


def varied(rng: np.random.Generator, image: np.ndarray) -> np.ndarray:
    """Return an image with other contrast, light and colours."""
    values = image.astype(np.float32)
    if rng.random() < 0.5:
        values = (values - 127) * rng.uniform(0.7, 1.3) + 127 + rng.normal(0, 20)
    if rng.random() < 0.5:
        values = values[..., rng.permutation(3)]
    if rng.random() < 0.1:
        values = 255 - values
    return (np.clip(values, 0, 255) - 127.5) / 64


def tensors(rng: np.random.Generator, those: list[Example]) -> tuple[torch.Tensor, torch.Tensor]:
    """Return images and maps of a batch, all turned and mirrored in one way."""
    images = np.stack([varied(rng, image) for image, _ in those]).transpose(0, 3, 1, 2)
    maps = np.stack([m for _, m in those]).astype(np.float32)
    if rng.random() < 0.5:
        images, maps = images[..., ::-1], maps[..., ::-1].copy()
        maps[:, 2] *= -1
    if rng.random() < 0.5:
        images, maps = images[:, :, ::-1], maps[:, :, ::-1].copy()
        maps[:, 3] *= -1
    if rng.random() < 0.5:
        images = images.swapaxes(-1, -2)
        maps = maps[:, [0, 1, 3, 2]].swapaxes(-1, -2)
    return tuple(torch.from_numpy(np.ascontiguousarray(a, np.float32)) for a in (images, maps))


def loss_of(said: torch.Tensor, true: torch.Tensor) -> torch.Tensor:
    """Return how wrong the maps are."""
    part, depth = torch.sigmoid(said[:, 0]), torch.sigmoid(said[:, 1])
    there = true[:, 0]
    overlap = (2 * (part * there).sum() + 1) / (part.sum() + there.sum() + 1)
    there_loss = F.binary_cross_entropy_with_logits(said[:, 0], there) + 1 - overlap
    depth_error = F.smooth_l1_loss(depth, true[:, 1], beta=0.1, reduction="none")
    way_error = F.smooth_l1_loss(said[:, 2:], true[:, 2:], beta=0.05, reduction="none").sum(1)
    way_loss = (way_error * there).sum() / (there.sum() + 1)
    return there_loss + 4 * (depth_error * (0.3 + there)).mean() + way_loss


def train(steps: int, seed: int, workers: int, state: Path) -> Network:
    """Train, or go on from a state that was saved."""
    torch.manual_seed(seed)
    network = Network()
    optimiser = torch.optim.AdamW(network.parameters(), RATE, weight_decay=1e-4)
    first = 0
    if state.exists():
        saved = torch.load(state)
        network.load_state_dict(saved["network"])
        optimiser.load_state_dict(saved["optimiser"])
        first = saved["step"]
    began = told = time.monotonic()
    losses, hits = [], []
    for step, those in zip(range(first, steps), batches(seed, first, workers), strict=False):
        rng = np.random.default_rng((seed, step, 2))
        images, maps = tensors(rng, those)
        warm = min(1.0, (step + 1) / 100)
        for group in optimiser.param_groups:
            group["lr"] = float(RATE * warm * (0.5 * (1 + np.cos(np.pi * step / steps)) + 0.01))
        said = network(images)
        loss = loss_of(said, maps)
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimiser.step()
        losses.append(loss.item())
        both = (said[:, 0] > 0) & (maps[:, 0] > 0.5)
        either = (said[:, 0] > 0) | (maps[:, 0] > 0.5)
        hits.append(both.sum().item() / max(1, either.sum().item()))
        if time.monotonic() - told > SAVED_S or step == steps - 1:
            told = time.monotonic()
            left = (told - began) / (step + 1 - first) * (steps - step - 1)
            print(
                f"step {step + 1} of {steps}: loss {np.mean(losses):.4f}, "
                f"overlap {np.mean(hits):.3f}, {left / 60:.0f} minutes left",
                flush=True,
            )
            losses, hits = [], []
            kept = {"network": network.state_dict(), "optimiser": optimiser.state_dict()}
            torch.save({**kept, "step": step + 1}, state)
    return network


def export(network: Network, path: Path) -> None:
    """Write the network's ONNX file, for images of any size."""
    network.eval()
    axes = {"image": {0: "n", 2: "h", 3: "w"}, "maps": {0: "n", 2: "h", 3: "w"}}
    torch.onnx.export(
        network, (torch.zeros(1, 3, 128, 192),), str(path), input_names=["image"],
        output_names=["maps"], dynamic_axes=axes, opset_version=13, dynamo=False,
    )  # fmt: skip


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=20_000, help="(20000)")
    parser.add_argument("--seed", type=int, default=1, help="(1)")
    parser.add_argument("--workers", type=int, default=1, help="that draw scenes (1)")
    parser.add_argument("--threads", type=int, default=1, help="of the network (1)")
    parser.add_argument("--out", type=Path, default=Path("segmenter.onnx"), help="(segmenter.onnx)")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    state = args.out.with_suffix(".pt")
    network = train(args.steps, args.seed, args.workers, state)
    export(network, args.out)
    print(f"{args.out}: {sum(p.numel() for p in network.parameters())} numbers")


if __name__ == "__main__":
    main()
