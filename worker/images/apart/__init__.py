"""Decoding in processes of their own, where a crash, a hang or a blow-up of a codec ends nothing else."""
