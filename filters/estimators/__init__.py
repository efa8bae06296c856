"""The filters: each turns a belief and a step's measurements into the next belief; they know no log and no grid."""
