"""Quality of the gradients of renderers, side by side: ``python -m benchmarks.gradient_quality``.

- `triangles`: lone triangles of 1 to 256 pixels, against closed forms.
- `scenes`: occlusion, crossing faces, textures, light, an orbit, wires, borders, against finite differences.
- `practice`: poses and shapes found with each gradient.
- `adapters`: the renderers. A further one takes 30 lines, see `adapters.Adapter`.
- `report`: the table and the figure.

Each renderer's mean gradient g over sub-pixel shifts is compared with the truth t: size = g . t / t . t (1 is right),
and the cosine between them. Noise is the deviation of single shifts' gradients from their mean, relative to the truth.
"""
