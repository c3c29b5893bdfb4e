/* The functions of learn.c in space. */
#define DIMENSIONS 3
#include "learn.c"
