/* HMAC-SHA256 (RFC 2104, FIPS 180-4) for a board without a library that has it. With mbed TLS, use
   mbedtls_md_hmac in its place. Nothing here allocates; a key has at most 64 bytes. */
#ifndef HMAC_SHA256_H
#define HMAC_SHA256_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

typedef struct {
    uint32_t h[8];
    uint8_t block[64];
    uint64_t n; /* bytes so far */
} sha256;

static uint32_t sha256_turn(uint32_t x, int n) { return x >> n | x << (32 - n); }

static void sha256_block(sha256 *s) {
    static const uint32_t K[64] = {
        0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
        0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
        0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
        0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
        0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
        0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
        0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
        0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};
    uint32_t w[64], v[8];
    for (int t = 0; t < 16; ++t) {
        const uint8_t *at = s->block + 4 * t;
        w[t] = (uint32_t)at[0] << 24 | (uint32_t)at[1] << 16 | (uint32_t)at[2] << 8 | at[3];
    }
    for (int t = 16; t < 64; ++t) {
        const uint32_t a = w[t - 15], b = w[t - 2];
        w[t] = w[t - 16] + w[t - 7] + (sha256_turn(a, 7) ^ sha256_turn(a, 18) ^ a >> 3) +
               (sha256_turn(b, 17) ^ sha256_turn(b, 19) ^ b >> 10);
    }
    memcpy(v, s->h, sizeof v);
    for (int t = 0; t < 64; ++t) {
        const uint32_t a = v[0], e = v[4];
        const uint32_t one = v[7] + (sha256_turn(e, 6) ^ sha256_turn(e, 11) ^ sha256_turn(e, 25)) +
                             ((e & v[5]) ^ (~e & v[6])) + K[t] + w[t];
        const uint32_t two = (sha256_turn(a, 2) ^ sha256_turn(a, 13) ^ sha256_turn(a, 22)) +
                             ((a & v[1]) ^ (a & v[2]) ^ (v[1] & v[2]));
        memmove(v + 1, v, 7 * sizeof *v);
        v[4] += one;
        v[0] = one + two;
    }
    for (int k = 0; k < 8; ++k) s->h[k] += v[k];
}

static void sha256_begin(sha256 *s) {
    static const uint32_t H[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                                  0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
    memcpy(s->h, H, sizeof H);
    s->n = 0;
}

static void sha256_add(sha256 *s, const void *data, size_t size) {
    for (size_t k = 0; k < size; ++k) {
        s->block[s->n++ % 64] = ((const uint8_t *)data)[k];
        if (s->n % 64 == 0) sha256_block(s);
    }
}

static void sha256_end(sha256 *s, uint8_t digest[32]) {
    const uint64_t bits = 8 * s->n;
    sha256_add(s, "\x80", 1);
    while (s->n % 64 != 56) sha256_add(s, "", 1);
    for (int k = 7; k >= 0; --k) sha256_add(s, &(uint8_t){(uint8_t)(bits >> 8 * k)}, 1);
    for (int k = 0; k < 32; ++k) digest[k] = (uint8_t)(s->h[k / 4] >> (24 - 8 * (k % 4)));
}

/* The code over two parts of a text, as if they stood one behind the other. */
static void hmac_sha256(const char *key, const char *first, const char *text, size_t size,
                        uint8_t code[32]) {
    uint8_t pad[64] = {0};
    sha256 s;
    memcpy(pad, key, strlen(key));
    for (int k = 0; k < 64; ++k) pad[k] ^= 0x36;
    sha256_begin(&s);
    sha256_add(&s, pad, 64);
    sha256_add(&s, first, strlen(first));
    sha256_add(&s, text, size);
    sha256_end(&s, code);
    for (int k = 0; k < 64; ++k) pad[k] ^= 0x36 ^ 0x5c;
    sha256_begin(&s);
    sha256_add(&s, pad, 64);
    sha256_add(&s, code, 32);
    sha256_end(&s, code);
}
#endif
