// The Pico's PIO program on the emulator rp2040js: an encoder is turned, and each count read as the sketch reads it.
//
//   node rp2040.mjs FOLDER_OF_RP2040JS '[[words], wrap target, wrap]'
import { pathToFileURL } from 'url';
import path from 'path';

const { RP2040 } = await import(pathToFileURL(path.join(process.argv[2], 'dist/esm/index.js')));
const [words, target, wrap] = JSON.parse(process.argv[3]);
const PIO0 = 0x50200000, PADS = 0x4001c000, RXF0 = 0x20, FLEVEL = 0x0c;
const READS = 5000, CYCLES_PER_EDGE = 12, INPUT_ENABLED = 0x5a;

const chip = new RP2040();
const pio = chip.pio[0];
pio.run = () => {}; // steps are taken below
const write = (at, value) => chip.writeUint32(PIO0 + at, value >>> 0);
const read = (at) => chip.readUint32(PIO0 + at) >>> 0;
const cycles = (n) => { while (n--) pio.step(); };

for (const pin of [2, 3]) chip.writeUint32(PADS + 4 + 4 * pin, INPUT_ENABLED);
words.forEach((word, k) => write(0x48 + 4 * k, word));
write(0xc8, 1 << 16); // as fast as the chip
write(0xcc, (wrap << 12) | (target << 7));
write(0xd0, 0); // shift to the left, no autopush
write(0xdc, 2 << 15); // the first input pin
write(0xd8, target); // jump there
write(0x00, 1);

let count = 0, wrong = 0;
const turn = (to) => {
  while (count !== to) {
    count += count < to ? 1 : -1;
    const phase = ((count % 4) + 4) % 4;
    chip.gpio[2].setInputValue(phase === 1 || phase === 2);
    chip.gpio[3].setInputValue(phase === 2 || phase === 3);
    cycles(CYCLES_PER_EDGE);
  }
};
turn(0);
for (let k = 0; k < READS; k++) {
  turn(Math.round(3000 * Math.sin(k * 8e-3) + 5 * Math.sin(k * 0.9)));
  for (let old = (read(FLEVEL) >> 4) & 15; old; old--) { read(RXF0); cycles(4); }
  while (((read(FLEVEL) >> 4) & 15) === 0) cycles(1);
  if ((read(RXF0) | 0) !== count) wrong++;
}
console.log(JSON.stringify({ reads: READS, wrong }));
