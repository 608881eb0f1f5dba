#define L3_DECIDED 0x80000000u /* set in first_class if the class does not depend on the structure or leaf */
#define L3_TURN 14             /* first bit of the orientation in gradient */

/* Rule that classifies pixels by the strength and direction of edges. */
typedef struct {
    int strengths;      /* number of strength edges */
    uint32_t coherence; /* in units of 1/64 */
    const uint32_t *strength_edges; /* (edge) */
} L3Structure;

/* Rule that classifies pixels by the leaf of a tree of threshold tests. The tree is divided into parts of at most 32 leaves. The tests are
 * stored in groups. The first groups, one for every 32 parts, determine the part of a pixel. They are followed by one group for each
 * part, which determines the leaf. A pixel passes a test if numerator > threshold * denominator. */
typedef struct {
    int parts;                  /* number of parts */
    const uint32_t *start;      /* (group + 1) first test of each group, then the number of tests */
    const uint32_t *first_leaf; /* (part) */
    const float *threshold;     /* (test) */
    const uint8_t *numerator;   /* (test) index of the numerator */
    const uint8_t *denominator; /* (test) index of the denominator */
    const uint32_t *ruled_out;  /* (test) parts, or leaves of the part, that a passed test excludes, as bits */
} L3Tree;

/* A layer that reads the planes of the previous layer. The last layer has no fixed-point weights. */
typedef struct {
    int side, taps;                                  /* side of the window; number of taps in all planes, with padding */
    const uint32_t *gradient;                        /* (class of the first layer) bits 0-7: factor for gradients; from bit 8: shift; */
                                                     /* from bit L3_TURN: orientation of the site. The orientation of a structure */
                                                     /* is the signs of a and b. The orientation of a tree is transposed, mirrored */
                                                     /* across, and mirrored down. */
    const uint32_t *first_class;                     /* (class of the first layer) class with structure or leaf 0. If a pixel nearby */
                                                     /* is saturated: the class itself, plus L3_DECIDED */
    const L3Structure *structure;                    /* structure rule, or null */
    const L3Tree *tree;                              /* tree rule, or null */
    const int16_t *fixed_weights;                    /* (class, plane, tap) */
    const int32_t *fixed_intercept;                  /* (class, plane) */
    const uint8_t *fraction;                         /* (class) number of fractional bits */
} L3PlaneLayer;

