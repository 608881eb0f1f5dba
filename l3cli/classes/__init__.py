"""Classification of pixels in integer arithmetic (docs/method.md#classes), shared by training and all renderers.

A *class rule* assigns a pixel to a class from features of the patch around it. Each feature has its own module: level,
contrast, saturation, chroma and direction. The module contains the feature's integer formula, the macros and constants for
its OpenCL snippet (opencl/), and the names of its values for tables and plots.

* `keys` declares the recipe keys for the basic features, which every class rule has. `features` declares the recipe tables
  that enable additional features.
* `windows` and `statistics` compute the statistics from which all features are derived. Let v = DN >> shift be the values in
  the p × p patch around a pixel. For each channel, the statistics are the number n, the sum S and the sum of squares Q of
  these values. In addition, there are the channels that are saturated near the centre, and window sums for additional
  features.
* `rule` computes a camera's class rule from a class recipe. `decide` assigns each pixel to a class.
* `plane_kernel` prepares class rules for the OpenCL kernels. `names` describes classes in words.

`ClassRule` (artifacts/class_rule) stores a class rule and numbers its classes.

To add a feature, write a module with the functions of `features.FeatureModule`, and a snippet in opencl/. Then add the
feature to `features.FEATURES`, and declare the recipe table that enables it in `features.ClassRecipe`.
"""
