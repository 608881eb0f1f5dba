/* --------------------------------------------------------------------------------------------------------------- features */

/* Each function computes the value of a feature from sums over windows. README.md contains the formulas. */
#ifdef __GNUC__
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-parameter" /* some features use neither the level nor constants */
#endif

