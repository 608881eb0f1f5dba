"""Classification of pixels in integer arithmetic (docs/method.md#classes), shared by training and all renderers.

There is one module per feature of a pixel's neighbourhood: level, contrast, saturation, chroma and direction. Each module
holds the feature's integer formula, the macros and constants of its kernel snippet (opencl/), and the names of its values
in tables and plots.

* `keys` declares the recipe keys of the features that every rule has, and `features` the tables that switch others on.
* `windows` and `statistics` provide what all features read: for v = DN >> shift over the p × p neighbourhood of a pixel,
  the count n, sum S and sum of squares Q of every channel; the pattern of channels that are saturated near the centre; and
  sums over the windows that the features of a recipe request.
* `rule` makes a camera's class rule from a recipe, and `decide` returns the class of a pixel.
* `plane_kernel` prepares a rule for the OpenCL kernels, and `names` names classes.

ClassRule (artifacts/class_rule) stores a rule and numbers its classes.

To add a feature, write its module here, as `features.FeatureModule` describes, and its snippet in opencl/. Then add a line
to `features.FEATURES`, whose key is the recipe table that switches the feature on, and this table to
`features.ClassRecipe`.
"""
