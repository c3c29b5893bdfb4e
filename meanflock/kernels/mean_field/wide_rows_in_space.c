/* The step of wide_rows.c in space. */
#define DIMENSIONS 3
#include "wide_rows.c"
