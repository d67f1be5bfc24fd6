# In place of the module rp2 of the Pico: an assembler of the instructions that the sketch uses, as the data sheet of the
# RP2040 encodes them.  A function of the program is its list of words; labels are resolved in a second pass.

SOURCES = {"pins": 0, "x": 1, "y": 2, "null": 3, "isr": 6, "osr": 7}
TARGETS = {"pins": 0, "x": 1, "y": 2, "pc": 5, "isr": 6, "osr": 7}


class PIO:
    SHIFT_LEFT, SHIFT_RIGHT = 0, 1


class Assembler:
    def __init__(self):
        self.labels, self.words, self.wrap_target, self.wrap = {}, [], 0, 31

    def names(self):
        found = {name: name for name in ("pins", "x", "y", "null", "isr", "osr", "pc", "noblock", "x_dec")}
        found.update(
            jmp=self.jmp,
            label=self.label,
            mov=self.mov,
            push=self.push,
            in_=self.in_,
            nop=lambda: self.mov("y", "y"),
            invert=lambda source: ("invert", source),
            wrap_target=self.begin_wrap,
            wrap=self.end_wrap,
        )
        return found

    def label(self, name):
        self.labels[name] = len(self.words)

    def begin_wrap(self):
        self.wrap_target = len(self.words)

    def end_wrap(self):
        self.wrap = len(self.words) - 1

    def jmp(self, condition, target=None):
        code = 0 if target is None else {"x_dec": 2}[condition]
        self.words.append(code << 5 | self.labels.get(condition if target is None else target, 0))

    def mov(self, target, source):
        change = 0
        if isinstance(source, tuple):
            change, source = 1, source[1]
        self.words.append(5 << 13 | TARGETS[target] << 5 | change << 3 | SOURCES[source])

    def push(self, block):
        assert block == "noblock"
        self.words.append(4 << 13)

    def in_(self, source, bits):
        self.words.append(2 << 13 | SOURCES[source] << 5 | bits & 31)


def asm_pio(in_shiftdir=PIO.SHIFT_LEFT):
    assert in_shiftdir == PIO.SHIFT_LEFT

    def decorated(function):
        made = Assembler()
        names = function.__globals__
        before = dict(names)
        names.update(made.names())
        function()
        made.words = []
        function()
        for name in made.names():
            names.pop(name)
        names.update(before)
        return made

    return decorated
