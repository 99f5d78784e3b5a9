"""Shared by all rooms: checks of arguments, sRGB, one-line `repr`, copies on other devices, cached constants."""
