class Pin:
    IN, PULL_UP = 0, 1
