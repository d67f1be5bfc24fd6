"""What all four packages share: errors, quantities, the console, output files, computing; it imports none of them."""
