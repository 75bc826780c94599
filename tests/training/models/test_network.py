import pytest
import torch
import torch.nn.functional as F  # noqa: N812

from training.models.initialization import initial_segmentation_network
from training.models.network import TrainedNetwork
from worker.encoders.compact.network import CompactNetwork
from worker.encoders.compact.segmentation import SegmentationNetwork


@pytest.mark.parametrize(("height", "width"), [(64, 96), (72, 100), (33, 47)])
def test_any_size_gives_two_unit_length_fields_at_an_eighth(height: int, width: int) -> None:
    network = CompactNetwork().eval()

    with torch.inference_mode():
        semantic, detail = network(torch.rand(2, 3, height, width))

    cells = (-(-height // 8), -(-width // 8))
    assert semantic.shape == (2, 97, *cells)
    assert detail.shape == (2, 64, *cells)
    assert torch.allclose(semantic.norm(dim=1), torch.ones(2, *cells), atol=1e-5)
    assert torch.allclose(detail.norm(dim=1), torch.ones(2, *cells), atol=1e-5)


def test_a_network_is_loaded_from_half_precision() -> None:
    network = CompactNetwork().eval()
    halved = {name: tensor.half() for name, tensor in network.state_dict().items()}
    image = torch.rand(1, 3, 64, 64)

    with torch.inference_mode():
        near = CompactNetwork.loaded(halved)(image)
        exact = network(image)

    for one, other in zip(near, exact, strict=True):
        assert one.dtype == torch.float32
        assert float((one * other).sum(dim=1).min()) > 0.999


@pytest.mark.parametrize(("height", "width"), [(64, 96), (72, 100), (33, 47)])
def test_the_segmentation_network_embeds_with_unit_length_at_a_quarter(height: int, width: int) -> None:
    network, segmentation = CompactNetwork().eval(), SegmentationNetwork().eval()

    with torch.inference_mode():
        embeddings = segmentation(*network.levels(torch.rand(2, 3, height, width)))

    cells = (-(-height // 4), -(-width // 4))
    assert embeddings.shape == (2, 97, *cells)
    assert torch.allclose(embeddings.norm(dim=1), torch.ones(2, *cells), atol=1e-5)


def test_before_training_the_segmentation_network_enlarges_the_semantic_field() -> None:
    network = TrainedNetwork().eval()
    segmentation = initial_segmentation_network(network).eval()
    images = torch.rand(1, 3, 64, 96)

    with torch.inference_mode():
        joined = network.fused(*network.shallow(images))
        enlarged = F.interpolate(joined, scale_factor=2.0, mode="bilinear", align_corners=False)

        assert torch.allclose(network.refined(images), enlarged, atol=1e-6)
        assert torch.allclose(
            segmentation(*network.levels(images)), F.normalize(network.words(enlarged), dim=1), atol=1e-6
        )
