"""The commands of ``defgrasp``, one module each."""
