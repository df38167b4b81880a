"""The motion of one pick: path search, free motions, and the plan of all of them."""
