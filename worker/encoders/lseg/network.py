"""LSeg as a whole: the image network and the text tower, named as the checkpoint names them."""

from torch import Tensor, nn

from worker.encoders.lseg.config import Config
from worker.encoders.lseg.decoder import Cells, Decoder, Reassemble, rounded_as_trained
from worker.encoders.lseg.text import TextTower
from worker.encoders.lseg.vit import VisionTransformer


class Backbone(nn.Module):
    """Transformer and reassembly: the checkpoint's ``pretrained``."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.model = VisionTransformer(config)
        first, second, _, fourth = config.tap_channels
        resample = (
            nn.ConvTranspose2d(first, first, 4, stride=4),
            nn.ConvTranspose2d(second, second, 2, stride=2),
            None,
            nn.Conv2d(fourth, fourth, 3, stride=2, padding=1),
        )
        for index, (channels, change) in enumerate(zip(config.tap_channels, resample, strict=True), start=1):
            self.add_module(f"act_postprocess{index}", Reassemble(config.width, channels, change))

    def forward(self, images: Tensor) -> list[Tensor]:
        """(images, 3, height, width) to four maps, finest first: 4, 2, 1 and 1/2 times the grid of patches."""
        taps, grid = self.model(images)
        return [self.get_submodule(f"act_postprocess{i}")(tap, grid) for i, tap in enumerate(taps, start=1)]


class Network(nn.Module):
    """Images to embeddings (`forward`), and labels to text vectors (`clip_pretrained`)."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        self.clip_pretrained = TextTower(config)
        self.pretrained = Backbone(config)
        self.scratch = Decoder(config)

    def forward(self, images: Tensor, keep: Cells | None = None) -> Tensor:
        """Embeddings at the head's resolution, half that of the images.

        Parameters
        ----------
        images : (images, 3, height, width)
            RGB in [-1, 1]; height and width multiples of the patch.
        keep : (int, int) or None
            Rows and columns of the result that are wanted, from the top left; None: all. The values do not change.

        Returns
        -------
        float16 of shape (images, height/2, width/2, channels)
            Of length 14.29 within rounding.
        """
        return rounded_as_trained(self.scratch(self.pretrained(images), keep))
