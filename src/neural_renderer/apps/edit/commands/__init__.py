"""Commands `style` and `dream`."""
