"""Command `render`: mesh files as pictures and animations."""
