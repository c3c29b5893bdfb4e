/* The step of row.c in space. */
#define DIMENSIONS 3
#include "row.c"
