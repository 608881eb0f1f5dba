"""Classification of pixels in integer arithmetic (docs/method.md#classes), shared by training and all renderers.

Each feature of a patch has its own module: level, contrast, saturation, chroma and direction. The module contains the
integer formula of the feature, the macros and constants for its OpenCL snippet (opencl/), and the names of its values for
tables and plots.

* `keys` declares the recipe keys of the features that every class rule has. `features` declares the recipe tables that
  enable additional features.
* `windows` and `statistics` compute the statistics from which the features are computed. Let v = DN >> shift be the values
  in the p × p patch around a pixel. For each channel, the statistics are the number n, the sum S and the sum of squares Q
  of the values v. In addition, they contain the channels that are saturated near the centre, and the sums over the windows
  of additional features.
* `rule` computes the class rule of a camera from a class recipe. `decide` determines the class of each pixel.
* `plane_kernel` prepares a class rule for the OpenCL kernels. `names` returns the names of classes.

`ClassRule` (artifacts/class_rule) stores a class rule and numbers its classes.

To add a feature, write a module in this package, as `features.FeatureModule` describes, and its snippet in opencl/. Then add
the feature to `features.FEATURES`, and declare the recipe table that enables it in `features.ClassRecipe`.
"""
