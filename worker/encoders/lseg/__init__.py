"""LSeg (Li et al., ICLR 2022): the network of the paper, in plain PyTorch, under the names its checkpoint uses."""
