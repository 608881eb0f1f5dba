/* Classes by the strength and direction of edges. */
typedef struct {
    int strengths;
    uint32_t coherence; /* 64ths */
    const uint32_t *strength_edges; /* (edge) */
    const int8_t *turns;            /* (site, component) */
} L3Structure;

/* Classes by the leaves of a tree of threshold tests. */
typedef struct {
    const uint8_t *test;    /* (node) */
    const float *threshold; /* (node) */
    const int32_t *branch;  /* (node) the first of its two branches, which follow one another; 0: a leaf */
    const uint16_t *leaf;   /* (node) */
    const uint8_t *turns;   /* (site) */
} L3Tree;

/* A layer that reads the planes of the layer before. */
typedef struct {
    int side, taps; /* of its windows; their taps in all planes, filled up */
    uint32_t levels, level_step, structures, kinds;
    const uint8_t *gradient_factor, *gradient_shift; /* (level of the first layer) */
    const L3Structure *structure;                    /* either this … */
    const L3Tree *tree;                              /* … or this */
    const int16_t *fixed_weights;                    /* (class, plane, tap), */
    const int32_t *fixed_intercept;                  /* (class, plane) */
    const uint8_t *fraction;                         /* and (class) of all but the last layer */
} L3PlaneLayer;

