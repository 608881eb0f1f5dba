"""Training of refinement layers (docs/method.md#learning-on-mosaics).

A refinement layer filters the output of the previous layers. A window of this output depends on more raw pixels than a patch
contains. The layer is therefore trained on *mosaics*: pieces of training frames, rendered by the previous layers. Every
mosaic is rendered twice, with and without noise. The noisy rendering determines the classes, just as for real frames. The
noise-free rendering provides the samples. The difference of the two provides the noise covariance, because noise is
correlated between pixels after the first layer. As in the first layer, the transforms are Wiener filters.

The module `mosaics` cuts and renders the mosaics, `samples` weights and sums the samples, `rules` determines the class rule,
`learn` solves the transforms, and `coarse_chroma` measures the noise for the coarse chroma filter.
"""
