/* A rectangle of the patch. Its values, times `sign` (1 or -1), are added to the sum with the number `sum`. */
typedef struct {
    int sum, top, left, rows, columns, sign;
} L3Window;

