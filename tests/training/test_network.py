import pytest
import torch

from worker.encoders.compact_network import CompactNetwork


@pytest.mark.parametrize(("height", "width"), [(64, 96), (72, 100), (33, 47)])
def test_any_size_gives_two_unit_length_fields_at_an_eighth(height: int, width: int) -> None:
    network = CompactNetwork().eval()

    with torch.inference_mode():
        words, detail = network(torch.rand(2, 3, height, width))

    cells = (-(-height // 8), -(-width // 8))
    assert words.shape == (2, 97, *cells)
    assert detail.shape == (2, 64, *cells)
    assert torch.allclose(words.norm(dim=1), torch.ones(2, *cells), atol=1e-5)
    assert torch.allclose(detail.norm(dim=1), torch.ones(2, *cells), atol=1e-5)


def test_a_network_is_loaded_from_half_precision() -> None:
    network = CompactNetwork().eval()
    halved = {name: tensor.half() for name, tensor in network.state_dict().items()}
    picture = torch.rand(1, 3, 64, 64)

    with torch.inference_mode():
        near = CompactNetwork.loaded(halved)(picture)
        exact = network(picture)

    for one, other in zip(near, exact, strict=True):
        assert one.dtype == torch.float32
        assert float((one * other).sum(dim=1).min()) > 0.999
