"""Training of refinement layers (docs/method.md#learning-on-mosaics).

A refinement layer filters the output of the previous layers. A window of this output depends on more raw pixels than a patch
contains. The layer is therefore trained on *mosaics*: pieces of training frames, rendered with the previous layers. Every
mosaic is rendered twice, with and without noise. The noisy rendering determines the classes, as in real frames. The
noise-free rendering provides the samples. The difference between the two is the noise, which is correlated between pixels
after the first layer. The transforms are Wiener filters for this noise covariance, as in the first layer.

The module `mosaics` cuts and renders the mosaics, `samples` weights and sums the samples, `rules` determines the class rule,
`learn` solves the transforms, and `coarse_chroma` measures the noise for the coarse chroma filter.
"""
