"""``python -m training`` is `training.commands.train`."""

from training.commands.train import main

if __name__ == "__main__":
    main()
