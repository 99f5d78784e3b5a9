"""Applications of the renderer: a folder for each, with its library, options and commands.

An application imports the core and `common`. One that is built on others names them in its first lines, after "Built
on". A new one needs a folder here and a line in `commands`; its page is a file in docs/tools.
"""
