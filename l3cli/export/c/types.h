#define L3_DECIDED 0x80000000u
#define L3_TURN 14

/* Classes by the strength and direction of edges. */
typedef struct {
    int strengths;
    uint32_t coherence; /* 64ths */
    const uint32_t *strength_edges; /* (edge) */
} L3Structure;

/* Classes by the leaves of a tree of threshold tests, which is cut into parts of at most 32 leaves. Tests stand in groups: the first,
 * one for each 32 parts, decide the part of a pixel, then one for each part its leaf. */
typedef struct {
    int parts;
    const uint32_t *start;      /* (group + 1) first test of each group, and behind the last */
    const uint32_t *first_leaf; /* (part) */
    const float *threshold;     /* (test) passed by a numerator above it times the denominator; */
    const uint8_t *numerator;   /* (test) which these are, */
    const uint8_t *denominator; /* (test) */
    const uint32_t *ruled_out;  /* (test) and bits of the parts, or leaves of the part, that are out then */
} L3Tree;

/* A layer that reads the planes of the layer before. */
typedef struct {
    int side, taps; /* of its windows; their taps in all planes, filled up */
    const uint32_t *gradient;                        /* (class of the first layer) factor, from bit 8 on shift of gradients, from */
                                                     /* bit L3_TURN on how the site is turned; structure: signs of a and b; */
                                                     /* tree: transposed, mirrored across, mirrored down */
    const uint32_t *first_class;                     /* (class of the first layer) class of structure or leaf 0; with L3_DECIDED */
                                                     /* where a pixel is saturated: the class */
    const L3Structure *structure;                    /* classes by structure, or null */
    const L3Tree *tree;                              /* classes by a tree, or null */
    const int16_t *fixed_weights;                    /* (class, plane, tap), */
    const int32_t *fixed_intercept;                  /* (class, plane) */
    const uint8_t *fraction;                         /* and (class) of all but the last layer */
} L3PlaneLayer;

