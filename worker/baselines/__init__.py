"""What a method must beat: one small file each, all behind `worker.baselines.baseline.Baseline`."""
