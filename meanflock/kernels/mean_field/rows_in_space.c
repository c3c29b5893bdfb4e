/* The step of rows.c in space. */
#define DIMENSIONS 3
#include "rows.c"
