/* A C form in single precision, to see what that costs: before holdfast.c, by -include. System
   headers stay as they are; after them every double is a float. */
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define HOLDFAST_SINGLE
#define double float
#define sqrt sqrtf
#define fabs fabsf
#define floor floorf
