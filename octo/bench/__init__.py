"""What octo costs on this machine: the measurements behind ``octo bench``."""
