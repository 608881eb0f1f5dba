/* --------------------------------------------------------------------------------------------------------------- features */

/* Each function gives the value of a feature from sums over its windows, as README.md says. */
#ifdef __GNUC__
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-parameter" /* a feature need not read the level, or any constant */
#endif

