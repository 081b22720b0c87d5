"""Unitree Go1 for hts: model, numbers, channels and a pretrained policy."""
