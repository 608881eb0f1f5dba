"""Classes of pixels: the plain truth of docs/method.md#classes, in integers, shared by training and every renderer.

One module a feature of a pixel's neighbourhood: level, contrast, saturation, chroma. Each holds what is stored of a recipe's
keys, its integer formula, the macros and constants of its kernel snippet (opencl/), and its names in tables and plots.
`windows` and `statistics` give what all of them decide by: with v = DN >> shift over the p × p neighbourhood of a pixel, the
count n, sum S and sum of squares Q of every channel, and the pattern of channels that are saturated near its centre.
`rule` makes a camera's rule from a recipe, `decide` gives the class, `names` says what classes are called. How class indices
are numbered stands in ClassRule, beside how it is stored (artifacts/class_rule).

To add a feature: its module here, named in `rule.FEATURES` and asked by `rule` and `decide`; its keys in `recipe`, what is
stored and its axis in ClassRule; its snippet in opencl/, joined by rule.cl.
"""
