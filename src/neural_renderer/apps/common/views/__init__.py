"""Images with cameras: `load` reads them, `views.Views` holds them, `up` finds what is up."""
