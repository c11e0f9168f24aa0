/* Sends what two fingers read as lines, 150 a second: a header, then a row for each sample, in counts of the board.

   holdfast run MODEL --source "serial:///dev/ttyACM0?baud=230400&unit=count"

   There is no column of time: the clock of a small board is too coarse, so the time of arrival counts. The header
   comes again each second, for a program that opens the port later. */
const int PINS[] = {A0, A1, A2, A3, A4, A5}; /* X1, Y1, Z1, X2, Y2, Z2 */
const unsigned long PERIOD_US = 1000000UL / 150;
unsigned long due_us;
unsigned int row;

void setup() {
  Serial.begin(230400);
  due_us = micros();
}

void loop() {
  if ((long)(micros() - due_us) < 0) return;
  due_us += PERIOD_US;
  if (row++ % 150 == 0) Serial.println("X1,Y1,Z1,X2,Y2,Z2");
  for (int k = 0; k < 6; k++) {
    if (k) Serial.print(',');
    Serial.print(analogRead(PINS[k]));
  }
  Serial.println();
}
