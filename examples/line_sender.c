/* Sends what a hand feels as lines, 150 a second: a header, then a row for each sample, in newtons.

   cc -std=c99 -D_POSIX_C_SOURCE=200809L -o line_sender line_sender.c && ./line_sender | holdfast run --source -
   ./line_sender 300 sends 300 rows. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

/* Here the hand would be read. */
static double finger(int finger, int axis) {
  (void)finger, (void)axis;
  return 0.02 * ((double)rand() / RAND_MAX + (double)rand() / RAND_MAX - 1.0);
}

int main(int count, char **words) {
  long rows = count > 1 ? atol(words[1]) : 1L << 30;
  struct timespec due;
  clock_gettime(CLOCK_MONOTONIC, &due);
  printf("Time");
  for (int k = 1; k <= 6; k++) printf(",X%d,Y%d,Z%d", k, k, k);
  printf("\n");
  for (long row = 0; row < rows; row++) {
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
    printf("%ld.%09ld", (long)due.tv_sec, due.tv_nsec);
    for (int k = 0; k < 18; k++) printf(",%.4f", finger(k / 3, k % 3));
    printf("\n"); /* with its row: a reader waits for the end of a line */
    if (fflush(stdout)) return 1; /* its reader has gone */
    due.tv_nsec += 1000000000L / 150;
    if (due.tv_nsec >= 1000000000L) due.tv_nsec -= 1000000000L, due.tv_sec++;
  }
  return 0;
}
