"""Training of refinement layers (docs/method.md#learning-on-mosaics).

A refinement layer reads pictures, not patches: each of its windows depends on a larger piece of the mosaic through the
layers before. So it is trained on mosaics that those layers render. They render every mosaic twice. The noisy rendering
decides the classes, as it will when frames are rendered. The noise-free rendering gives the samples, and the difference
gives the covariance of the noise, which the layers before have correlated. From both, a Wiener filter follows as in the
first layer.

`mosaics` cuts and renders the mosaics, `samples` weighs and sums them up, `rules` makes the class rule, `learn` solves it.
"""
