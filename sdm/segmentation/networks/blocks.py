"""Blocks of layers that both networks are built of."""

from __future__ import annotations

from itertools import pairwise

from torch import nn


def convolutions(channels: list[int]) -> nn.Sequential:
    """3^3 convolutions from each number of channels to the next, each with batch normalisation and ReLU."""
    layers: list[nn.Module] = []
    for before, after in pairwise(channels):
        layers += [nn.Conv3d(before, after, 3, padding=1), nn.BatchNorm3d(after), nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)


def halve(before: int, after: int) -> nn.Sequential:
    """2^3 convolution of stride 2, batch normalisation, ReLU."""
    return nn.Sequential(nn.Conv3d(before, after, 2, stride=2), nn.BatchNorm3d(after), nn.ReLU(inplace=True))


def double(before: int, after: int) -> nn.Sequential:
    """2^3 transposed convolution of stride 2, batch normalisation, ReLU."""
    return nn.Sequential(nn.ConvTranspose3d(before, after, 2, stride=2), nn.BatchNorm3d(after), nn.ReLU(inplace=True))
