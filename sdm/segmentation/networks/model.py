"""A network with the outputs that a method needs."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

from sdm.losses import probability_from_sdf
from sdm.segmentation.data.position_channels import CHANNELS
from sdm.segmentation.networks.unet import UNetDecoder, UNetEncoder
from sdm.segmentation.networks.vnet import VNetDecoder, VNetEncoder
from sdm.segmentation.train.methods import Method

Architecture = Literal["vnet", "unet"]
NETWORKS = {"vnet": (VNetEncoder, VNetDecoder, 16), "unet": (UNetEncoder, UNetDecoder, 8)}


class SegmentationModel(nn.Module):
    """From images (B,1,x,y,z), with positions (B,4,x,y,z), to the main output and, for some methods, a distance map.

    The reconstruction branch is a decoder of its own from the coarsest level, without skips, so that the map has to
    be found in the code that both share. In Ma's published code the branch shares the decoder, which is a head.

    Args:
        method: What to put out.
        architecture: "vnet" or "unet".
        filters: Channels of the finest level; the paper's if not given (16 and 64).
        dropout: Of the coarsest level; the paper's if not given (0.5 and 0.05).
        last_dropout: Of what the main output, and a head's, is made of.
        position: Whether three more channels say where each voxel is in its volume: see `positions`.
        coarsen: How many times as large as an image's voxels are those that the network is for: see `coarse`. `predict`
            makes them and enlarges what the network says.
    """

    def __init__(
        self,
        method: Method,
        architecture: Architecture = "vnet",
        *,
        filters: int | None = None,
        dropout: float | None = None,
        last_dropout: float = 0.0,
        position: bool = False,
        coarsen: int = 1,
    ) -> None:
        super().__init__()
        encoder, decoder, self.multiple = NETWORKS[architecture]
        width = {} if filters is None else {"filters": filters}
        self.method, self.position, self.coarsen = method, position, coarsen
        inputs = 1 + CHANNELS if position else 1
        self.encoder = encoder(**width, **({} if dropout is None else {"dropout": dropout}), inputs=inputs)
        self.decoder = decoder(**width, dropout=last_dropout)
        self.branch = decoder(**width, skips=False) if method.auxiliary == "branch" else None
        self.main = nn.Conv3d(self.decoder.channels, 1, 1)
        self.auxiliary = nn.Conv3d(self.decoder.channels, 1, 1) if method.auxiliary else None

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor | None]:
        """Main and auxiliary output (B,1,x,y,z), float32.

        The main one is a logit or a signed distance, as the method says. The auxiliary one is in 0..1 for the map of
        the foreground, in -1..1 for a signed one.
        """
        value, branched = self.decoded(image)
        main = self.main(value).float()
        if self.method.output == "tanh":
            main = main.tanh()
        if self.auxiliary is None:
            return main, None
        other = self.auxiliary(branched).float()
        return main, other.sigmoid() if self.method.map == "foreground" else other.tanh()

    def decoded(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Features of the main and the auxiliary output, (B,filters,x,y,z) each: the same but with a branch."""
        features = self.encoder(image)
        value = self.decoder(features)
        return value, value if self.branch is None else self.branch(features)

    def field(self, image: Tensor) -> Tensor:
        """(B,1,x,y,z) float32 that is negative where the foreground is predicted.

        A signed distance (in the target's scale) of a method that regresses one, else one half minus the probability:
        a quantity that windows and scans may average, and that is cut at zero.
        """
        main = self(image)[0]
        return 0.5 - main.sigmoid() if self.method.output == "logit" else main


def probability(main: Tensor, method: Method) -> Tensor:
    """The foreground's probability for losses: the logit's, or a steep step of the signed distance."""
    return torch.sigmoid(main) if method.output == "logit" else probability_from_sdf(main)
