"""Classes of pixels: the plain truth of docs/method.md#classes, in integers, shared by training and every renderer.

One module a feature of a pixel's neighbourhood: level, contrast, saturation, chroma. Each holds what is stored of a recipe's
keys, its integer formula, the macros and constants of its kernel snippet (opencl/), and its names in tables and plots.
`windows` and `statistics` give what all of them decide by: with v = DN >> shift over the p × p neighbourhood of a pixel, the
count n, sum S and sum of squares Q of every channel, the pattern of channels that are saturated near its centre, and sums
over the windows that further features ask for.
`rule` makes a camera's rule from a recipe, `decide` gives the class, `kernel` is how kernels see a rule, `names` says what
classes are called. How class indices are numbered stands in ClassRule, beside how it is stored (artifacts/class_rule).

To add a feature: its module here, with what `features.FurtherFeature` asks for; its snippet in opencl/; and a line in
`features.FURTHER`, whose key is the table of a recipe that switches it on.
"""
