"""What networks learn from: images, label maps, text labels, augmentation, and batches drawn from them."""
