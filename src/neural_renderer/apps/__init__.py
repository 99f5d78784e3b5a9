"""Applications of the renderer: a folder for each, with its library, options and commands.

An application imports the core and `common`. One that is built on another says so in its first lines. A new one needs
a folder here and a line in `commands`.
"""
