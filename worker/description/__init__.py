"""Image to description: the describer, the scheduler of the encoder, local features, vocabularies, presets."""
