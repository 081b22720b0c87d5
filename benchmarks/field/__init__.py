"""What a script does that plays the operator of a run in the world `field`: visits, kills, books."""
