"""What every room uses: checks of arguments, one-line texts of objects, moves between devices, constants."""
