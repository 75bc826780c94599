"""What a method must beat: one small file each, all behind `lab.baselines.baseline.Baseline`."""
