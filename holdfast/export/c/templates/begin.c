/* Holdfast model @MODEL_ID@ as C99. Generated from the sealed ONNX file; do not edit.
   SHA-256 of the file: @DIGEST@
   Compile with -ffp-contract=off; see holdfast.h. */
#include "holdfast.h"

#include <float.h>
#include <math.h>
#include <string.h>

#if HOLDFAST_MODEL != @TAG@
#error "holdfast.h is of another model: generate both again"
#endif
#if FLT_EVAL_METHOD != 0
#error "float and double must be computed as float and double (on x86: SSE2, not x87)"
#endif
#if DBL_MANT_DIG != 53 || FLT_MANT_DIG != 24
#error "float and double must be those of IEEE 754"
#endif

/* a model need not use every helper */
#ifdef __GNUC__
#define HF_HELPER __attribute__((unused)) static
#else
#define HF_HELPER static
#endif
