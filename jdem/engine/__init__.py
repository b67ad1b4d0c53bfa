"""How a bed is advanced: contact lists, one time step, the one loop."""
