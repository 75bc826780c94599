"""Image to description: describer, scheduler of the encoder, local features, vocabularies, presets."""
