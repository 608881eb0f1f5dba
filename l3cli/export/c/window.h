/* A rectangle of the patch whose values are added to a sum, or taken off. */
typedef struct {
    int sum, top, left, rows, columns, sign;
} L3Window;

