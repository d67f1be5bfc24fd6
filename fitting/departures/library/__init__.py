"""The departures, one file each; `fitting.departures.table` lists them."""
