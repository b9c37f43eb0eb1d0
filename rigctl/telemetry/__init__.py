"""What leaves the loop: rings in shared memory, and the Zenoh gateway that reads them."""
