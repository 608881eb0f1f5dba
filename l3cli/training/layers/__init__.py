"""Training of refinement layers (docs/method.md#learning-on-mosaics).

A refinement layer reads the output of the previous layers. A window of this output depends on more raw pixels than one patch
contains. The layer is therefore trained on *mosaics*, pieces of training frames that the previous layers render. Every
mosaic is rendered twice, with and without noise. The rendering with noise determines the classes, as in the rendering of
real frames. The rendering without noise provides the samples. The difference between the two renderings provides the
covariance of the noise, which is correlated between pixels after the first layer. As in the first layer, the transforms are
Wiener filters.

The module `mosaics` cuts and renders the mosaics, `samples` weights and sums the samples, `rules` determines the class rule,
and `learn` solves the transforms.
"""
