"""Training of refinement layers (docs/method.md#learning-on-mosaics).

A refinement layer reads the output of the previous layers. Each of its windows depends on a larger piece of the mosaic than
one patch, so the layer is trained on mosaics that the previous layers render. They render every mosaic twice, with and
without noise. The rendering with noise determines the classes, as it does when frames are rendered later. The rendering
without noise gives the samples. The difference between the two gives the covariance of the noise, which the previous layers
have correlated. The transforms are then Wiener filters, as in the first layer.

`mosaics` cuts and renders the mosaics. `samples` weights the samples and adds them up. `rules` makes the class rule. `learn`
solves the transforms.
"""
