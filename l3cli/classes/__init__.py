"""Classification of pixels in integer arithmetic (docs/method.md#classes), shared by training and all renderers.

There is one module for each feature of a patch: level, contrast, saturation, chroma and direction. The module contains
the integer formula of the feature, the macros and constants of its OpenCL snippet (opencl/), and the names of its values
in tables and plots.

* `keys` declares the recipe keys of the features that every class rule has. `features` declares the recipe tables that
  enable additional features.
* `windows` and `statistics` compute the numbers that the features are computed from. Let v = DN >> shift be the values
  in the p × p patch around a pixel. The numbers are the count n, the sum S and the sum of squares Q of the values of
  each channel, the channels that are saturated near the centre, and sums over the windows of additional features.
* `rule` makes the class rule of a camera from a class recipe, and `decide` returns the class of a pixel.
* `plane_kernel` prepares a class rule for the OpenCL kernels, and `names` returns the names of classes.

`ClassRule` (artifacts/class_rule) stores a class rule and numbers its classes.

To add a feature, write its module here, as `features.FeatureModule` describes, and its snippet in opencl/. Then add a
line to `features.FEATURES`, whose key is the name of the recipe table that enables the feature, and declare this table
in `features.ClassRecipe`.
"""
