"""FMI: our vehicle as an FMU, and the FMUs of others as plants and simulators."""
