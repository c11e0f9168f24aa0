/* What holdfast.c needs of <math.h>: instructions of WebAssembly. */
#define INFINITY __builtin_inff()
#define NAN __builtin_nanf("")
#define fabs __builtin_fabs
#define fabsf __builtin_fabsf
#define floor __builtin_floor
#define floorf __builtin_floorf
#define sqrt __builtin_sqrt
#define sqrtf __builtin_sqrtf
