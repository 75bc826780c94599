"""What networks learn from: images, label maps, text labels, augmentation, and the batches drawn from them."""
